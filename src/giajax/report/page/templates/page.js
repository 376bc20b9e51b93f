"use strict";
(() => {
  const told = (id) => JSON.parse(document.getElementById(id).textContent);

  // One plot after the other, so that the page can be read while the rest is drawn.
  const places = [...document.querySelectorAll("[data-plot]")];
  const next = async () => {
    const place = places.shift();
    if (!place) { document.body.dataset.drawn = "all"; return; }
    // An error in one plot must not prevent the others from being drawn.
    try {
      await Bokeh.embed.embed_item(told(place.dataset.plot), place);
    } catch (error) {
      console.error(error);
      place.textContent = "This plot could not be drawn.";
    }
    setTimeout(next, 0);
  };
  if (window.Bokeh) { Bokeh.set_log_level("warn"); next(); }

  // Scrolling by touch must not zoom a plot, so only a plot that was tapped receives touch input.
  if (matchMedia("(pointer: coarse)").matches) {
    const plots = [...document.querySelectorAll("[data-plot]")];
    // `inert` is used because BokehJS sets pointer-events within the plot.
    plots.forEach((one) => { one.inert = true; });
    document.body.classList.add("touch");
    addEventListener("click", (event) => {
      const tapped = event.target.closest(".panel, .narrow");
      for (const one of plots) {
        const live = Boolean(tapped) && (tapped === one || tapped.contains(one));
        one.inert = !live;
        one.classList.toggle("live", live);
      }
    });
  }

  // Open collapsed sections before printing, so that they appear on paper.
  addEventListener("beforeprint", () => {
    document.querySelectorAll("details").forEach((one) => { one.open = true; });
    const widest = Math.max(0, ...[...document.querySelectorAll(".plot")].map((one) => one.clientWidth));
    if (widest) document.body.style.setProperty("--shrink", Math.min(325 / widest, 0.62));
  });

  const place = document.querySelector("canvas.arm");
  if (!place) return;
  const scene = told("scene");
  const slider = document.querySelector("#frame"), shown = document.querySelector("#time");
  const play = document.querySelector("#play"), pen = place.getContext("2d");
  const count = scene.frames.length, views = [[2, "side"], [1, "top"]];
  let frame = 0, timer = null;

  const layout = () => {
    const width = place.clientWidth, margin = 26;
    const reach = views.map(([up]) => Math.max(scene.size[up], 0.12 * Math.max(...scene.size)));
    const below = width < 640;
    const across = below ? width : width / 2;
    // A tall arm must not fill more than a screen.
    const scale = Math.min((across - 2 * margin) / Math.max(scene.size[0], 1),
      420 / Math.max(...reach));
    const heights = reach.map((size) => size * scale + 2 * margin);
    const height = below ? heights[0] + heights[1] : Math.max(...heights);
    return { width, height, margin, scale, across, below, heights, reach };
  };
  const draw = () => {
    const size = layout(), ratio = devicePixelRatio || 1;
    place.style.height = `${size.height}px`;
    place.width = size.width * ratio; place.height = size.height * ratio;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, size.width, size.height);
    views.forEach(([up, name], which) => {
      const left = size.below ? 0 : which * size.across, top = size.below ? which * size.heights[0] : 0;
      const spare = size.across - 2 * size.margin - scene.size[0] * size.scale;
      const middle = (size.reach[which] - scene.size[up]) / 2;
      const at = (points, i) => [
        left + size.margin + spare / 2 + points[3 * i] * size.scale,
        top + size.heights[which] - size.margin - (points[3 * i + up] + middle) * size.scale];
      pen.fillStyle = "#666"; pen.font = "12px system-ui, sans-serif";
      pen.fillText(`${name} view (x, ${"xyz"[up]})`, left + 8, top + 16);
      for (const line of scene.lines) {
        const points = line.points[frame], body = line.radii.some((r) => r > 0);
        const slack = line.loose && line.loose[frame];
        pen.setLineDash(slack ? [4, 4] : []); pen.lineCap = "butt";
        for (let i = 0; i + 1 < line.radii.length; i++) {
          if (points[3 * i] === null || points[3 * i + 3] === null) continue;
          pen.beginPath(); pen.moveTo(...at(points, i)); pen.lineTo(...at(points, i + 1));
          if (body) {
            pen.strokeStyle = "rgba(118,118,118,0.28)";
            pen.lineWidth = Math.max((line.radii[i] + line.radii[i + 1]) * size.scale, 1);
            pen.stroke();
          }
          pen.strokeStyle = body ? "#888" : "#0072b2"; pen.lineWidth = body ? 0.8 : 1.4; pen.stroke();
        }
        pen.setLineDash([]);
      }
      const dots = (several, colour, radius, hollow) => several.forEach((points) => {
        const row = points[frame];
        if (row[0] === null || row[up] === null) return;
        pen.beginPath(); pen.arc(...at(row, 0), radius, 0, 7);
        if (hollow) { pen.strokeStyle = colour; pen.lineWidth = 1.4; pen.stroke(); }
        else { pen.fillStyle = colour; pen.fill(); }
      });
      dots(scene.markers, "#222", 1.8, false);
      dots(scene.recorded, "#d55e00", 3.6, true);
      if (which === 0) {
        const length = 10 ** Math.floor(Math.log10(scene.size[0] * scene.step / 2));
        const px = length / scene.step * size.scale, y = top + size.heights[which] - 8;
        pen.fillStyle = "#666"; pen.fillRect(left + size.margin, y, px, 2);
        pen.fillText(`${length} m`, left + size.margin + px + 5, y + 4);
      }
    });
    slider.value = frame;
    shown.textContent = scene.times ? `${scene.times[frame].toFixed(2)} s` : `sample ${scene.frames[frame]}`;
  };
  const stop = () => { clearInterval(timer); timer = null; play.textContent = "Play"; };
  slider.max = count - 1;
  slider.addEventListener("input", () => { stop(); frame = Number(slider.value); draw(); });
  play.addEventListener("click", () => {
    if (timer) { stop(); return; }
    if (frame === count - 1) frame = 0;
    play.textContent = "Pause";
    // Play in real time, or faster if the motion lasts longer than 15 s.
    const whole = scene.times ? scene.times[count - 1] - scene.times[0] : count / 10;
    const wait = 1000 * Math.min(whole, 15) / count;
    timer = setInterval(() => { if (frame >= count - 1) stop(); else { frame += 1; draw(); } }, wait);
  });
  addEventListener("resize", draw);
  addEventListener("beforeprint", draw);
  frame = Math.floor(count / 2);
  draw();
})();
