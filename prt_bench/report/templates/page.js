/* The page's state: which group of rows is shown, light or dark, and the order of the tables. */
const data = JSON.parse(document.getElementById("data").textContent);
const FIELDS = ["scene", "scenario", "split", "device"];
const $ = (id) => document.getElementById(id);
let group = data.groups[0];

function element(tag, properties, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/* Choosing a value keeps as many of the other choices as exist together with it, the leftmost first. */
function choose(field, value) {
  const score = (other) => FIELDS.reduce((sum, name, place) => sum + (other[name] === group[name] ? 1 << (9 - place) : 0), 0);
  group = data.groups.filter((other) => other[field] === value).reduce((best, other) => (score(other) > score(best) ? other : best));
  show();
}

function drawSelector() {
  $("selector").replaceChildren(...FIELDS.map((field, place) => {
    const fixed = FIELDS.slice(0, place);
    const open = data.groups.filter((other) => fixed.every((name) => other[name] === group[name]));
    const values = [...new Set((place ? open : data.groups).map((other) => other[field]))];
    const buttons = values.map((value) => element("button", {
      type: "button", textContent: value, title: value, ariaPressed: String(value === group[field]), onclick: () => choose(field, value),
    }));
    return element("fieldset", {}, element("legend", { textContent: field }), ...buttons);
  }));
}

function show() {
  drawSelector();
  for (const part of document.querySelectorAll("[data-group]")) part.hidden = data.groups[part.dataset.group] !== group;
  for (const part of document.querySelectorAll("[data-scene]")) {
    part.hidden = part.dataset.scene !== group.scene || part.dataset.scenario !== group.scenario;
  }
  drawCharts();
  showPictures();
}

/* Numbers sort as numbers, what was not measured goes last in either direction. */
function sortBy(head) {
  const table = head.closest("table");
  const column = [...head.parentNode.children].indexOf(head);
  const rising = head.getAttribute("aria-sort") !== "ascending";
  for (const other of head.parentNode.children) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", rising ? "ascending" : "descending");
  const numeric = head.classList.contains("number");
  const body = table.tBodies[0];
  const key = (row) => row.cells[column].dataset.key;
  const compare = numeric ? (a, b) => a - b : (a, b) => a.localeCompare(b);
  body.append(...[...body.rows].sort((a, b) => {
    const [first, second] = [key(a), key(b)];
    if (first === "" || second === "") return (first === "") - (second === "");
    return (rising ? 1 : -1) * compare(first, second);
  }));
}

function applyTheme(theme) {
  document.documentElement.dataset.theme = theme;
}

function start() {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  applyTheme(dark.matches ? "dark" : "light");
  document.documentElement.classList.add("scripted");
  const change = (theme) => { applyTheme(theme); drawCharts(); };
  dark.addEventListener("change", () => change(dark.matches ? "dark" : "light"));
  $("theme").onclick = () => change(document.documentElement.dataset.theme === "dark" ? "light" : "dark");
  for (const button of document.querySelectorAll(".board thead button")) button.onclick = () => sortBy(button.closest("th"));
  startCharts();
  startViewer();
  if (group) show();
}
