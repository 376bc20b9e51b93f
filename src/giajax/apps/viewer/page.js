"use strict";
// Additions to the scene of viser: a camera that shows the whole arm in any window, a legend and a plot.
(() => {
const about = JSON.parse(document.getElementById("about").textContent);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const plus = (a, s, b) => a.map((part, k) => part + s * b[k]);
const unit = (a) => a.map((part) => part / Math.hypot(...a));
const turned = ([w, ...v], p) => plus(plus(p, 2 * w, cross(v, p)), 2, cross(v, cross(v, p)));

// ---- the camera
const MARGIN = 0.06;  // of the picture, on each side
const behind = unit(about.from), right = unit(cross([0, 0, 1], behind)), up = cross(behind, right);
let points = about.points, moved = false, fitted = "", placed = null;

// The nearest camera along a direction that has every point between two slopes across and two
// upwards. A point at (x, depth) is right of the slope h of a camera at (c, d) where
// x - c > h (depth - d): each slope is one inequality in c and d, and the worst point decides.
function nearest(across, depth, low, high) {
  const most = Math.max(...across.map((x, i) => x - high * depth[i]));
  const least = Math.min(...across.map((x, i) => x - low * depth[i]));
  return { depth: (least - most) / (high - low), at: (d) => (most + least + (high + low) * d) / 2 };
}

function fit() {
  const viewer = window.__viserMutable, root = window.__viserSceneTree?.getState()[""];
  // Another version of viser may lack these: its page starts with a camera that suits most windows.
  if (!viewer?.cameraControl || !viewer.canvas || !root) return;
  const [width, height] = [viewer.canvas.clientWidth, viewer.canvas.clientHeight];
  // A legend in a corner leaves room for the arm; a legend across a narrow window does not.
  const covered = aside.offsetWidth > 0.6 * width ? aside.offsetHeight : 0, key = [width, height, covered, viewer.camera.fov, points].join();
  // The message with viser's own initial camera may arrive after the first fit.
  const stands = placed && placed.every((part, k) => Math.abs(part - viewer.camera.position.toArray()[k]) < 1e-3);
  if (moved || !width || (key === fitted && stands)) return;
  fitted = key;
  const slope = Math.tan(viewer.camera.fov * Math.PI / 360), side = slope * width / height;
  const depth = points.map((p) => -dot(p, behind));
  const free = Math.max(1 - 2 * covered / height, 0);
  const x = nearest(points.map((p) => dot(p, right)), depth, -side * (1 - 2 * MARGIN), side * (1 - 2 * MARGIN));
  const y = nearest(points.map((p) => dot(p, up)), depth, -slope * (1 - 2 * MARGIN), slope * (free - 2 * MARGIN));
  const d = Math.min(x.depth, y.depth), far = (Math.min(...depth) + Math.max(...depth)) / 2;
  const place = (z) => plus(plus(right.map((part) => part * x.at(d)), y.at(d), up), -z, behind);
  const control = viewer.cameraControl;
  viewer.camera.up.set(...turned(root.wxyz, [0, 0, 1]));
  control.updateCameraUp();
  placed = turned(root.wxyz, place(d));
  control.setPosition(...placed, false);
  control.setTarget(...turned(root.wxyz, place(far)), false);
}
document.addEventListener("pointermove", (event) => {
  if (event.buttons && event.target.localName === "canvas" && !aside.contains(event.target)) moved = true;
});
document.addEventListener("keydown", (event) => {
  const control = event.target.closest?.("input, select, button, [role=slider]");
  if (!control && /^(Key[WASDQE]|Arrow)/.test(event.code)) moved = true;
});
document.addEventListener("wheel", (event) => {
  if (event.target.localName === "canvas" && !aside.contains(event.target)) moved = true;
});
// Called by an enclosing page when its arm reaches new positions.
window.showAll = (more) => { points = more; fit(); };

// ---- the panel of viser, which is at the bottom of a narrow window and covers the arm: collapsed
// By its style, because viser removes what it collapses itself: the time bar, which the plot reads.
const HANDLE = '[style*="width: 20em"] [style*="cursor: pointer"][style*="height: 3.5em"]', collapsed = new WeakSet();
function collapse() {
  const handle = document.querySelector(HANDLE);
  if (!handle || collapsed.has(handle)) return;
  collapsed.add(handle);
  const panel = handle.closest('[style*="width: 20em"]');
  panel.classList.add("collapsed");
  handle.addEventListener("click", (event) => {
    event.stopPropagation();
    panel.classList.toggle("collapsed");
  }, true);
}

// ---- the legend
const element = (tag, attributes, parent) => {
  const one = Object.assign(document.createElement(tag), attributes);
  parent?.append(one);
  return one;
};
const aside = element("details", { id: "legend", open: innerHeight > 600, className: about.dark ? "dark" : "" });
element("summary", { textContent: about.title }, aside);
const rows = element("ul", {}, aside);
for (const [colour, text] of about.legend) {
  const row = element("li", {}, rows);
  element("i", {}, row).style.background = colour;
  row.append(text);
}
element("button", { type: "button", textContent: "show the whole arm", onclick: async () => {
  moved = false;
  fitted = "";
  if (about.live) {
    // The pose or the place of the arm may have changed since the page was loaded.
    const page = new DOMParser().parseFromString(await (await fetch(location.href)).text(), "text/html");
    points = JSON.parse(page.getElementById("about").textContent).points;
  }
  fit();
} }, aside);

// ---- a video of the scene, from one click to the next
const type = ["video/mp4", "video/webm"].find((each) => window.MediaRecorder?.isTypeSupported(each));
if (type) {
  let recorder = null;
  const button = element("button", { type: "button", textContent: "record a video", onclick: () => {
    if (recorder) { recorder.stop(); return; }
    const scene = window.__viserMutable?.canvas;
    if (!scene) return;
    // The canvas of the scene is transparent, and its size may change. The one that is recorded
    // has the background of the page, and an even size, which some encoders need.
    const [width, height] = [scene.width & ~1, scene.height & ~1];
    const copy = element("canvas", { width, height }), pen = copy.getContext("2d");
    pen.fillStyle = about.dark ? "#1c1c1e" : "#ffffff";
    recorder = new MediaRecorder(copy.captureStream(30), { mimeType: type, videoBitsPerSecond: 8e6 });
    (function paint() {
      pen.fillRect(0, 0, width, height);
      pen.drawImage(scene, 0, 0, width, height);
      if (recorder) requestAnimationFrame(paint);
    })();
    const parts = [];
    recorder.ondataavailable = (event) => parts.push(event.data);
    recorder.onstop = () => {
      const href = URL.createObjectURL(new Blob(parts, { type })), extension = type.split("/")[1];
      element("a", { href, download: `${about.title.replace(/[^\w.-]+/g, "_")}.${extension}` }).click();
      setTimeout(() => URL.revokeObjectURL(href), 60e3);
      recorder = null;
      button.textContent = "record a video";
    };
    recorder.start();
    button.textContent = "stop and save the video";
  } }, aside);
}

// ---- the plot: recorded values as dots, and a vertical line at the current time
const COLOURS = about.dark ? ["#56b4e9", "#f08a4b", "#2fbf95", "#d78fc0"] : ["#0072b2", "#d55e00", "#009e73", "#b0568f"];
const DASHES = [["solid", []], ["dashed", [6, 3]], ["dotted", [2, 2]]];
let canvas = null, choice = null, curves = null, drawn = "";
// A chosen curve keeps its style, the first one that no other chosen curve has, until it is removed.
function free(plot) {
  for (let style = 0; ; style++) if (plot.curves.every((one) => one.style !== style)) return style;
}
const styled = ({ style }) => [COLOURS[style % 4], ...DASHES[Math.floor(style / 4) % 3]];
const redraw = () => { drawn = ""; draw(); };
function offer() {
  const plot = about.plots[choice.selectedIndex];
  curves.replaceChildren();
  const longest = Math.max(...plot.curves.map((curve) => curve.name.length));
  curves.style.gridTemplateColumns = `repeat(auto-fill, calc(42px + ${longest}ch))`;
  for (const curve of plot.curves) {
    const label = element("label", {}, curves);
    const box = element("input", { type: "checkbox", checked: curve.chosen }, label);
    const sample = element("i", {}, label);
    label.append(curve.name);
    const choose = () => {
      curve.chosen = box.checked;
      curve.style = box.checked ? curve.style ?? free(plot) : undefined;
      const [colour, dash] = box.checked ? styled(curve) : ["transparent", "solid"];
      Object.assign(sample.style, { borderTopColor: colour, borderTopStyle: dash });
    };
    choose();
    box.onchange = () => { choose(); redraw(); };
  }
  choice.nextSibling.textContent = plot.curves.some((curve) => curve.dots.length) ? "dots: recorded" : "";
  canvas.ariaLabel = `${plot.title}, versus time`;
}
if (about.plots.length) {
  const figure = element("figure", {}, aside);
  choice = element("select", { ariaLabel: "quantity plotted versus time" }, figure);
  about.plots.forEach((plot) => element("option", { textContent: plot.title }, choice));
  element("span", {}, figure);
  canvas = element("canvas", { role: "img" }, figure);
  curves = element("fieldset", { ariaLabel: "plotted curves" }, figure);
  choice.onchange = () => { offer(); redraw(); };
  offer();
}
function ticks(low, high, count) {
  const rough = (high - low) / count, power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((each) => each * power >= rough), found = [];
  for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  return found.map((each) => [each, each.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)))]);
}
function draw() {
  if (!canvas || !aside.open) return;
  const value = document.querySelector("[role=slider]")?.ariaValueNow;
  const time = about.live ? Number(value ?? about.first) : about.first + Number(value ?? 0);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight], ratio = devicePixelRatio;
  const key = [time, width, height, choice.selectedIndex].join();
  if (key === drawn || !width) return;
  drawn = key;
  const plot = about.plots[choice.selectedIndex], pen = canvas.getContext("2d"), times = about.times;
  [canvas.width, canvas.height] = [width * ratio, height * ratio];
  pen.scale(ratio, ratio);
  pen.font = "11px system-ui, sans-serif";
  const ink = getComputedStyle(aside).color;
  const chosen = plot.curves.filter((curve) => curve.chosen);
  const known = chosen.flatMap((curve) => [...curve.values, ...curve.dots]).filter((one) => one !== null);
  let [low, high] = known.length ? [Math.min(...known), Math.max(...known)] : [0, 1];
  const room = (high - low) * 0.05 || Math.abs(high) * 0.05 || 1;
  [low, high] = [low - room, high + room];
  const end = times.at(-1), box = { left: 60, right: width - 10, top: 6, bottom: height - 30 };
  const across = (t) => box.left + (t - times[0]) / (end - times[0]) * (box.right - box.left);
  const upwards = (v) => box.bottom - (v - low) / (high - low) * (box.bottom - box.top);
  pen.strokeStyle = "#8884"; pen.fillStyle = ink; pen.textAlign = "right"; pen.textBaseline = "middle";
  const line = (a, b, c, d) => { pen.beginPath(); pen.moveTo(a, b); pen.lineTo(c, d); pen.stroke(); };
  for (const [v, text] of ticks(low, high, 4)) {
    line(box.left, upwards(v), box.right, upwards(v)); pen.fillText(text, box.left - 4, upwards(v));
  }
  pen.textAlign = "center";
  for (const [t, text] of ticks(times[0], end, width / 70)) {
    line(across(t), box.top, across(t), box.bottom); pen.fillText(text, across(t), box.bottom + 9);
  }
  pen.fillText("time, s", (box.left + box.right) / 2, height - 7);
  pen.save();
  pen.translate(8, (box.top + box.bottom) / 2);
  pen.rotate(-Math.PI / 2);
  pen.fillText(plot.axis, 0, 0);
  pen.restore();
  // A curve of one value is constant.
  const each = (values, use) => times.forEach((t, i) => {
    const v = values.length > 1 ? values[i] : values[0] ?? null;
    use(v === null ? null : [across(t), upwards(v)]);
  });
  for (const curve of chosen) {
    const [colour, , dash] = styled(curve);
    pen.strokeStyle = pen.fillStyle = colour;
    each(curve.dots, (at) => { if (at) pen.fillRect(at[0] - 1, at[1] - 1, 2, 2); });
    pen.setLineDash(dash);
    pen.lineWidth = 1.5;
    pen.beginPath();
    let away = true;
    each(curve.values, (at) => {
      if (at) { if (away) pen.moveTo(...at); else pen.lineTo(...at); }
      away = !at;
    });
    pen.stroke();
  }
  pen.setLineDash([]);
  pen.lineWidth = 1;
  pen.strokeStyle = ink;
  line(across(time), box.top, across(time), box.bottom);
}

// The panel of viser shows its address, and with it the token, to everybody who sees the screen.
const hide = () => document.querySelectorAll("input").forEach((input) => {
  if (/^wss?:/.test(input.value)) input.style.display = "none";
});
addEventListener("DOMContentLoaded", () => {
  document.title = about.title;
  document.body.append(aside);
  setInterval(() => { fit(); draw(); hide(); collapse(); }, 100);
});
})();
