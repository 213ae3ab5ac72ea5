/* Pictures in linear radiance: decoded to floats, exposed, wiped and differenced on canvases. */
const decoded = new Map(); // promises of pictures, by key
const HALF = Float32Array.from({ length: 65536 }, (_, bits) => {
  const [exponent, fraction] = [(bits >> 10) & 31, bits & 1023];
  const size = exponent === 0 ? fraction * 2 ** -24 : exponent === 31 ? (fraction ? NaN : Infinity) : (1 + fraction / 1024) * 2 ** (exponent - 15);
  return bits & 32768 ? -size : size;
});
const SRGB = Uint8ClampedArray.from({ length: 4097 }, (_, index) => {
  const value = index / 4096;
  return 255 * (value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055) + 0.5;
});
let shown = null; // what the canvases show: left, right and their exposed canvases
let drawing = 0; // counts requests, so that a slow decode never overwrites a later choice

async function inflate(key) {
  const source = $(`picture-${key}`);
  const bytes = Uint8Array.from(atob(source.textContent), (character) => character.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const { width, height, peak } = source.dataset;
  return { width: +width, height: +height, peak: +peak, planes: new Uint8Array(await new Response(stream).arrayBuffer()) };
}

/* Inverse of `encode_reference`: join high and low bytes, undo the steps along rows, read the bits as half floats. */
async function decodeReference(key) {
  const { width, height, planes } = await inflate(key);
  const count = width * height;
  const pixels = new Float32Array(3 * count);
  for (let channel = 0; channel < 3; channel++) {
    let bits = 0;
    for (let index = 0; index < count; index++) {
      const step = (planes[channel * count + index] << 8) | planes[(3 + channel) * count + index];
      bits = (index % width ? bits + step : step) & 65535;
      pixels[3 * index + channel] = HALF[(bits << 3) & 65535];
    }
  }
  return { width, height, pixels };
}

/* Inverse of `encode_difference`, added to its reference. */
async function decodePrediction(key, reference) {
  const { width, height, peak, planes } = await inflate(key);
  const pixels = new Float32Array(reference.pixels);
  const count = width * height;
  for (let channel = 0; channel < 3; channel++) {
    let level = 0;
    for (let index = 0; index < count; index++) {
      const step = planes[channel * count + index];
      level = ((index % width ? level + step : step) << 24) >> 24;
      pixels[3 * index + channel] += peak * Math.sign(level) * (level / data.levels) ** 2;
    }
  }
  return { width, height, pixels };
}

function once(name, make) {
  if (!decoded.has(name)) decoded.set(name, make());
  return decoded.get(name);
}

const referenceOf = (row) => once(row.pictures[view()][1], () => decodeReference(row.pictures[view()][1]));
const predictionOf = (row) => once(row.pictures[view()].join(" "), async () => decodePrediction(row.pictures[view()][0], await referenceOf(row)));

/* The level that all but one lit pixel in fifty stay under; exposure 0 shows it as white. */
function brightEnd(picture) {
  const levels = new Float32Array(picture.pixels.length / 3);
  for (let index = 0; index < levels.length; index++) levels[index] = Math.max(picture.pixels[3 * index], picture.pixels[3 * index + 1], picture.pixels[3 * index + 2]);
  const lit = levels.filter((level) => level > 0).sort();
  return lit.length ? lit[Math.floor(0.98 * (lit.length - 1))] : 1;
}

function paint(canvas, picture, fill) {
  canvas.width = picture.width;
  canvas.height = picture.height;
  const image = new ImageData(picture.width, picture.height);
  fill(image.data);
  canvas.getContext("2d").putImageData(image, 0, 0);
  return canvas;
}

function expose(canvas, picture, gain) {
  return paint(canvas, picture, (out) => {
    for (let from = 0, to = 0; from < picture.pixels.length; from += 3, to += 4) {
      for (let channel = 0; channel < 3; channel++) out[to + channel] = SRGB[Math.min(Math.max(4096 * gain * picture.pixels[from + channel], 0), 4096) | 0];
      out[to + 3] = 255;
    }
  });
}

function difference(canvas, a, b, scale) {
  return paint(canvas, a, (out) => {
    for (let from = 0, to = 0; from < a.pixels.length; from += 3, to += 4) {
      let error = 0;
      for (let channel = 0; channel < 3; channel++) error += Math.abs(a.pixels[from + channel] - b.pixels[from + channel]) / 3;
      const hue = data.colormap[Math.min(255 * error / scale, 255) | 0];
      out.set(hue, to);
      out[to + 3] = 255;
    }
  });
}

const view = () => $("picture-view").value;
const pictured = () => group.rows.filter((row) => row.pictures[view()] && row.label !== "reference");
const gain = () => 2 ** +$("exposure").value / shown.bright;
const errorScale = () => 10 ** +$("scale").value * shown.bright;

/* The choice of one side: -1 is the reference, otherwise an index into the group's rows. */
async function side(choice) {
  return choice === "-1" ? referenceOf(pictured()[0]) : predictionOf(group.rows[+choice]);
}

/* After a change of group: the rows that have pictures, the best of them on the right. */
function showPictures() {
  const rows = group.rows.filter((row) => row.pictures.final || row.pictures.indirect);
  $("viewer").hidden = rows.length === 0;
  $("note-pictures").hidden = rows.length === 0;
  $("pictures").hidden = rows.length === 0;
  if (!rows.length) return;
  for (const option of $("picture-view").options) option.disabled = !group.rows.some((row) => row.pictures[option.value]);
  if ($("picture-view").selectedOptions[0].disabled) $("picture-view").value = [...$("picture-view").options].find((option) => !option.disabled).value;
  const options = () => pictured().map((row) => element("option", { value: group.rows.indexOf(row), textContent: row.label }));
  const before = { left: $("picture-left").selectedOptions[0]?.textContent, right: $("picture-right").selectedOptions[0]?.textContent };
  $("picture-left").replaceChildren(element("option", { value: -1, textContent: "reference" }), ...options());
  $("picture-right").replaceChildren(...options());
  for (const [name, label] of Object.entries(before)) {
    const same = [...$(`picture-${name}`).options].find((option) => option.textContent === label);
    if (same) same.selected = true;
  }
  loadPictures();
}

async function loadPictures() {
  const request = ++drawing;
  const [left, right] = [await side($("picture-left").value), await side($("picture-right").value)];
  const reference = await side("-1");
  if (request !== drawing) return;
  shown = { left, right, bright: brightEnd(reference), exposed: [document.createElement("canvas"), document.createElement("canvas")] };
  $("tag-left").textContent = $("picture-left").selectedOptions[0].textContent;
  $("tag-right").textContent = $("picture-right").selectedOptions[0].textContent;
  drawExposed();
  drawError();
  await drawStrip(request);
}

function drawExposed() {
  expose(shown.exposed[0], shown.left, gain());
  expose(shown.exposed[1], shown.right, gain());
  const stops = +$("exposure").value;
  $("exposure-shown").textContent = `${stops >= 0 ? "+" : "−"}${Math.abs(stops).toFixed(1)} EV`;
  drawWipe();
}

function drawWipe() {
  const canvas = $("wipe");
  const at = +$("wipe-at").value;
  canvas.width = shown.left.width;
  canvas.height = shown.left.height;
  const context = canvas.getContext("2d");
  const split = Math.round(at * canvas.width);
  context.drawImage(shown.exposed[1], 0, 0);
  if (split > 0) context.drawImage(shown.exposed[0], 0, 0, split, canvas.height, 0, 0, split, canvas.height);
  $("divider").style.left = `${100 * at}%`;
}

function drawError() {
  difference($("error"), shown.left, shown.right, errorScale());
  const share = 100 * 10 ** +$("scale").value;
  $("scale-shown").textContent = `${share < 1 ? share.toPrecision(2) : share.toFixed(0)} %`;
  $("bar-top").textContent = `≥ ${errorScale().toPrecision(2)} W/m²/sr, ${$("scale-shown").textContent} of the bright end`;
  const strip = new ImageData(256, 1);
  data.colormap.forEach((hue, index) => strip.data.set([...hue, 255], 4 * index));
  $("bar").getContext("2d").putImageData(strip, 0, 0);
}

/* Every method's error against the reference, at one scale; a click puts it on the right. */
async function drawStrip(request) {
  const items = [];
  for (const row of pictured()) {
    const canvas = difference(document.createElement("canvas"), await referenceOf(row), await predictionOf(row), errorScale());
    const index = String(group.rows.indexOf(row));
    items.push(element("button", {
      type: "button", ariaPressed: String($("picture-right").value === index), onclick: () => { $("picture-right").value = index; loadPictures(); },
    }, canvas, element("b", { textContent: row.label }), `rel. RMSE ${row.shown.relative_rmse}`));
  }
  if (request === drawing) $("strip").replaceChildren(...items);
}

function startViewer() {
  $("picture-left").onchange = $("picture-right").onchange = loadPictures;
  $("picture-view").onchange = showPictures;
  $("exposure").oninput = () => drawExposed();
  $("scale").oninput = drawError;
  $("scale").onchange = () => drawStrip(++drawing);
  $("wipe-at").oninput = drawWipe;
  const drag = (event) => {
    if (event.type === "pointermove" && !event.buttons) return;
    const box = $("wipe").getBoundingClientRect();
    $("wipe-at").value = (event.clientX - box.left) / box.width;
    drawWipe();
  };
  $("wipe").onpointerdown = (event) => { $("wipe").setPointerCapture(event.pointerId); drag(event); };
  $("wipe").onpointermove = drag;
}
