"use strict";
(function () {
  const data = JSON.parse(document.getElementById("data").textContent);
  const named = {};
  Bokeh.set_log_level("warn");

  // Equal scales on both axes, for any chart shape.
  function show(chart, ratio, cx, cy, halfX, halfY) {
    const w = chart.inner_width, h = chart.inner_height;
    if (!(w > 0 && h > 0)) return;
    const half = Math.max(halfX, halfY * w / (h * ratio));
    const halfUp = half * ratio * h / w;
    chart.x_range.setv({ start: cx - half, end: cx + half });
    chart.y_range.setv({ start: cy - halfUp, end: cy + halfUp });
  }
  function showBox(chart, ratio, box) {
    show(chart, ratio, (box[0] + box[2]) / 2, (box[1] + box[3]) / 2, (box[2] - box[0]) / 2, (box[3] - box[1]) / 2);
  }
  function keepEqual(name, ratio) {
    const chart = named[name];
    const whole = [chart.x_range.start, chart.y_range.start, chart.x_range.end, chart.y_range.end];
    let last = "";
    const fit = function () {
      const size = chart.inner_width + "x" + chart.inner_height;
      if (size === last || !(chart.inner_width > 0)) return;
      if (last === "") {
        showBox(chart, ratio, whole);
      } else {
        const x = chart.x_range, y = chart.y_range;
        show(chart, ratio, (x.start + x.end) / 2, (y.start + y.end) / 2, (x.end - x.start) / 2, 0);
      }
      last = size;
      chart.x_range.setv({ reset_start: chart.x_range.start, reset_end: chart.x_range.end });
      chart.y_range.setv({ reset_start: chart.y_range.start, reset_end: chart.y_range.end });
    };
    chart.properties.inner_width.change.connect(fit);
    chart.properties.inner_height.change.connect(fit);
    const later = () => requestAnimationFrame(() => requestAnimationFrame(fit));  // after a new layout
    new ResizeObserver(later).observe(document.getElementById("chart-" + name));
    fit();
    later();
  }

  // Readout under the pointer.
  function grid(one) {
    const text = atob(one.data), bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    const view = new DataView(bytes.buffer);
    return { box: one.box, rows: one.rows, cols: one.cols, at: (r, c) => view.getFloat32(4 * (r * one.cols + c), true) };
  }
  function heightAt(grids, lon, lat) {
    for (const one of grids) {
      const [w, s, e, n] = one.box;
      const c = (lon - w) / (e - w) * (one.cols - 1), r = (n - lat) / (n - s) * (one.rows - 1);
      if (!(c >= 0 && r >= 0 && c <= one.cols - 1 && r <= one.rows - 1)) continue;
      const c0 = Math.min(Math.floor(c), one.cols - 2), r0 = Math.min(Math.floor(r), one.rows - 2), a = c - c0, b = r - r0;
      return (1 - b) * ((1 - a) * one.at(r0, c0) + a * one.at(r0, c0 + 1)) + b * ((1 - a) * one.at(r0 + 1, c0) + a * one.at(r0 + 1, c0 + 1));
    }
    return NaN;
  }
  const metres = (m) => m >= 9999.5 ? (m / 1000).toPrecision(3) + " km" : m >= 999.5 ? m.toFixed(0) + " m" : m.toPrecision(3) + " m";
  const angle = (x, plus, minus) => Math.abs(x).toFixed(6) + "° " + (x >= 0 ? plus : minus);
  function readOut(grids) {
    const place = document.getElementById("readout");
    named.map.on_event("mousemove", function (event) {
      const lon = event.x, lat = event.y;
      if (!isFinite(lon) || !isFinite(lat)) return;
      const parts = [angle(lat, "N", "S") + ", " + angle((lon + 540) % 360 - 180, "E", "W")];
      const height = heightAt(grids, lon, lat);
      if (isFinite(height)) parts.push("ground about " + height.toFixed(0) + " m above WGS 84");
      for (const fix of data.fixes) {
        const turn = (lon - fix.lonlat[0] + 540) % 360 - 180;
        const east = turn * data.metres[0], north = (lat - fix.lonlat[1]) * data.metres[1];
        const azimuth = (Math.atan2(east, north) * 180 / Math.PI + 360) % 360;
        parts.push(metres(Math.hypot(east, north)) + " from " + fix.name + " at " + azimuth.toFixed(0) + "°");
      }
      place.replaceChildren(Object.assign(document.createElement("b"), { textContent: parts[0] }), parts.length > 1 ? " · " + parts.slice(1).join(" · ") : "");
    });
  }

  function buttons() {
    const chart = named.map, ratio = data.equal.map;
    for (const one of document.querySelectorAll("[data-zoom]"))
      one.addEventListener("click", () => showBox(chart, ratio, data.zooms[Number(one.dataset.zoom)].box));
    for (const one of document.querySelectorAll("[data-step]"))
      one.addEventListener("click", function () {
        const x = chart.x_range, y = chart.y_range;
        show(chart, ratio, (x.start + x.end) / 2, (y.start + y.end) / 2, Number(one.dataset.step) * (x.end - x.start) / 2, 0);
      });
    for (const one of document.querySelectorAll("[data-layer]"))
      one.addEventListener("change", function () {
        for (const layer of chart.renderers) if (layer.name === one.dataset.layer) layer.visible = one.checked;
      });
  }

{% include "sortable.js" %}

  // Charts in the colours of the page: those of Python are the light ones.
  const dark = window.matchMedia("screen and (prefers-color-scheme: dark)");
  const INK = "#e8e8e8", MUTED = "#a8a8a8", HAIR = "#3a3f44", SOFT = "#202428", PAPER_COLOUR = "#14171a";
  const GLYPHS = { "#1a1a1a": INK, "#0072b2": "#6db9ea", "#4a148c": "#c3a0f5", "#fefefe": PAPER_COLOUR };
  const coloured = [];  // [model, light, dark]
  function add(model, colours) {
    coloured.push([model, Object.fromEntries(Object.keys(colours).map((name) => [name, model[name]])), colours]);
  }
  function collect() {
    for (const [name, chart] of Object.entries(named)) {
      add(chart, { border_fill_color: PAPER_COLOUR, background_fill_color: name === "map" ? SOFT : PAPER_COLOUR, outline_line_color: HAIR });
      for (const axis of [...chart.below, ...chart.left].filter((one) => "axis_label" in one))
        add(axis, { axis_line_color: MUTED, major_tick_line_color: MUTED, major_label_text_color: INK, axis_label_text_color: INK });
      for (const lines of chart.center.filter((one) => "grid_line_color" in one)) add(lines, { grid_line_color: HAIR });
      for (const bar of chart.center.filter((one) => "bar_line_color" in one))
        add(bar, { background_fill_color: "#9aa0a6" });  // the bar itself keeps the colour that it is made with
      if (name === "map") continue;  // the relief is as light as ever
      for (const { glyph } of chart.renderers) {
        const given = ["line_color", "fill_color"].map((key) => [key, glyph[key] && (glyph[key].value || glyph[key])]);
        const other = given.filter(([, colour]) => colour in GLYPHS).map(([key, colour]) => [key, { value: GLYPHS[colour] }]);
        if (other.length) add(glyph, Object.fromEntries(other));
      }
    }
  }
  function paint() {
    for (const [model, light, other] of coloured) model.setv(dark.matches ? other : light);
  }

  // Charts are not laid out anew for paper: as they are on the screen, they are made as small as it.
  const PAPER = 180 * 96 / 25.4;  // CSS pixels between the margins of A4, and within those of letter
  function fitToPaper() {
    for (const chart of document.querySelectorAll(".chart")) {
      const width = chart.clientWidth, height = chart.clientHeight;
      Object.assign(chart.style, { width: width + "px", height: height + "px", zoom: Math.min(1, PAPER / width) });
    }
  }
  function fitToScreen() {
    for (const chart of document.querySelectorAll(".chart"))
      for (const name of ["height", "width", "zoom"]) chart.style.removeProperty(name);
  }
  window.addEventListener("beforeprint", fitToPaper);
  window.addEventListener("afterprint", fitToScreen);

  Bokeh.embed.embed_items(data.docs, data.items).then(function () {
    for (const root of Bokeh.documents[0].roots()) named[root.name] = root;
    for (const name of Object.keys(data.equal)) if (named[name]) keepEqual(name, data.equal[name]);
    readOut(data.heights.map(grid).reverse());
    buttons();
    collect();
    paint();
    dark.addEventListener("change", paint);
    document.documentElement.dataset.ready = "yes";
  });
})();
