/* Pictures in linear radiance: decoded to floats, exposed, wiped and differenced on canvases. */
const decoded = new Map();
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

/* Inverse of `byte_planes`: inflate, join the high and low bytes, and undo the differences along rows. */
async function decode(key) {
  if (decoded.has(key)) return decoded.get(key);
  const source = $(`picture-${key}`);
  const bytes = Uint8Array.from(atob(source.textContent), (character) => character.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer());
  const [width, height] = [+source.dataset.width, +source.dataset.height];
  const count = width * height;
  const pixels = new Float32Array(3 * count);
  for (let channel = 0; channel < 3; channel++) {
    let bits = 0;
    for (let index = 0; index < count; index++) {
      const step = (planes[channel * count + index] << 8) | planes[(3 + channel) * count + index];
      bits = index % width ? (bits + step) & 65535 : step;
      pixels[3 * index + channel] = HALF[bits];
    }
  }
  const picture = { width, height, pixels };
  decoded.set(key, picture);
  return picture;
}

/* The level that all but one pixel in a hundred stay under. */
function brightEnd(picture) {
  const levels = new Float32Array(picture.pixels.length / 3);
  for (let index = 0; index < levels.length; index++) levels[index] = Math.max(picture.pixels[3 * index], picture.pixels[3 * index + 1], picture.pixels[3 * index + 2]);
  levels.sort();
  return Math.max(levels[Math.floor(0.99 * (levels.length - 1))], 1e-6);
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
/* Rows with pictures, less a row whose picture is the reference itself. */
const pictured = () => group.rows.filter((row) => row.pictures[view()] && row.pictures[view()][0] !== row.pictures[view()][1]);
const gain = () => 2 ** +$("exposure").value * 0.9 / shown.bright;
const errorScale = () => 10 ** +$("scale").value * shown.bright;

/* The choice of one side: -1 is the reference, otherwise an index into the group's rows. */
function side(choice) {
  return choice === "-1" ? [pictured()[0].pictures[view()][1], "reference"] : [group.rows[+choice].pictures[view()][0], group.rows[+choice].label];
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
  const [[leftKey, leftName], [rightKey, rightName]] = [side($("picture-left").value), side($("picture-right").value)];
  const reference = await decode(pictured()[0].pictures[view()][1]);
  const [left, right] = [await decode(leftKey), await decode(rightKey)];
  if (request !== drawing) return;
  shown = { left, right, bright: brightEnd(reference), exposed: [document.createElement("canvas"), document.createElement("canvas")] };
  $("tag-left").textContent = leftName;
  $("tag-right").textContent = rightName;
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
    const [own, reference] = [await decode(row.pictures[view()][0]), await decode(row.pictures[view()][1])];
    const canvas = difference(document.createElement("canvas"), reference, own, errorScale());
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
