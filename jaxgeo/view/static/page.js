"use strict";
(function () {
  const byId = (id) => document.getElementById(id);
  const text = (id, words) => { byId(id).textContent = words; };
  // For screen readers: what is said at once takes the place of what still waits to be said.
  let saying;
  function say(words) { clearTimeout(saying); text("spoken", words); }
  function sayWhenStill(words) { clearTimeout(saying); saying = setTimeout(() => say(words()), 500); }
  const dark = matchMedia("(prefers-color-scheme: dark)");
  let colours = {};
  function readColours() {
    const style = getComputedStyle(document.documentElement);
    for (const name of ["card", "ink", "muted", "stage", "grid", "fix", "sight", "edge", "halo", "veil"])
      colours[name] = style.getPropertyValue("--" + name).trim();
  }

  // What is shown: the images, the map, the point asked for, and the points that are kept.
  const shown = { images: [], image: 0, edition: "", tiles: null, map: null, point: null, kept: [] };
  let asking = null;  // stops the request before the last one
  let mapIsShown;
  const mapShown = new Promise((done) => { mapIsShown = done; });

  // A canvas with a scale: dragging, wheel, two fingers, keys. The world's second axis points down.
  class Stage {
    constructor(canvas, how) {
      Object.assign(this, how, { canvas, context: canvas.getContext("2d"), x: 0, y: 0, scale: 1, whole: null, fitted: 1, cross: null });
      this.fingers = new Map();
      this.isKeyed = false;
      new ResizeObserver(() => this.resize()).observe(canvas);
      canvas.addEventListener("pointerdown", (event) => this.down(event));
      canvas.addEventListener("pointermove", (event) => this.move(event));
      for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => this.up(event, name === "pointerup"));
      canvas.addEventListener("pointerleave", () => { if (!this.isKeyed) this.readout.textContent = ""; });
      canvas.addEventListener("wheel", (event) => {
        event.preventDefault();
        this.zoom(Math.pow(2, -event.deltaY * (event.deltaMode ? 0.08 : 0.0025)), event.offsetX, event.offsetY);
      }, { passive: false });
      canvas.addEventListener("keydown", (event) => this.key(event));
      canvas.addEventListener("blur", () => { this.isKeyed = false; this.draw(); });
    }
    get width() { return this.canvas.clientWidth; }
    get height() { return this.canvas.clientHeight; }
    toScreen(x, y) { return [(x - this.x) * this.scale + this.width / 2, (y - this.y) * this.scale + this.height / 2]; }
    toWorld(px, py) { return [(px - this.width / 2) / this.scale + this.x, (py - this.height / 2) / this.scale + this.y]; }
    resize() {
      const ratio = devicePixelRatio || 1, isWhole = this.isWhole;
      this.canvas.width = Math.round(this.width * ratio);
      this.canvas.height = Math.round(this.height * ratio);
      if (this.whole && (isWhole || !(this.scale > 0))) this.fit(); else this.changed();
    }
    get isWhole() { return this.scale <= this.fitted * 1.02; }
    setWhole(left, top, right, bottom) { this.whole = [left, top, right, bottom]; this.fit(); }
    fit() {
      if (this.whole) this.show(...this.whole);
      this.fitted = this.scale;
      this.changed();
    }
    show(left, top, right, bottom) {
      this.x = (left + right) / 2;
      this.y = (top + bottom) / 2;
      this.scale = Math.min(this.width / Math.max(right - left, 1e-9), this.height / Math.max(bottom - top, 1e-9));
      this.changed();
    }
    zoom(factor, px, py) {
      if (!this.whole) return;
      const [x, y] = this.toWorld(px, py);
      this.scale = Math.min(Math.max(this.scale * factor, this.fitted * this.least), this.most);
      this.x = x - (px - this.width / 2) / this.scale;
      this.y = y - (py - this.height / 2) / this.scale;
      this.changed();
    }
    changed() {
      if (this.whole) {
        const [left, top, right, bottom] = this.whole;
        this.x = Math.min(Math.max(this.x, left), right);
        this.y = Math.min(Math.max(this.y, top), bottom);
      }
      this.canvas.classList.toggle("near", !this.isWhole);
      this.draw();
      clearTimeout(this.settling);
      this.settling = setTimeout(() => this.settled(), 180);
    }
    down(event) {
      if (event.button) return;
      this.isKeyed = false;
      this.fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
      this.pressed = this.fingers.size === 1 ? { at: [event.offsetX, event.offsetY], far: event.pointerType === "mouse" ? 4 : 10, isDrag: false } : { isDrag: true };
      try { this.canvas.setPointerCapture(event.pointerId); } catch { /* a pointer that is gone */ }
    }
    move(event) {
      const at = [event.offsetX, event.offsetY], before = this.fingers.get(event.pointerId);
      if (!before) {
        const [x, y] = this.toWorld(...at);
        this.readout.textContent = this.whole ? this.tell(x, y) : "";
        return;
      }
      if (this.fingers.size === 2) {
        const other = [...this.fingers].find(([id]) => id !== event.pointerId)[1];
        const apart = (a) => Math.hypot(a[0] - other[0], a[1] - other[1]);
        const middle = [(at[0] + other[0]) / 2, (at[1] + other[1]) / 2];
        this.x -= (at[0] - before[0]) / 2 / this.scale;
        this.y -= (at[1] - before[1]) / 2 / this.scale;
        this.fingers.set(event.pointerId, at);
        this.zoom(apart(at) / Math.max(apart(before), 1), ...middle);
        return;
      }
      if (!this.pressed.isDrag && Math.hypot(at[0] - this.pressed.at[0], at[1] - this.pressed.at[1]) < this.pressed.far) return;
      this.pressed.isDrag = true;
      this.canvas.classList.add("moving");
      this.x -= (at[0] - before[0]) / this.scale;
      this.y -= (at[1] - before[1]) / this.scale;
      this.fingers.set(event.pointerId, at);
      this.changed();
    }
    up(event, isPick) {
      if (!this.fingers.delete(event.pointerId)) return;
      this.canvas.classList.remove("moving");
      if (isPick && !this.pressed.isDrag && this.whole) {
        this.cross = this.snapped(...this.toWorld(event.offsetX, event.offsetY));
        this.pick(...this.cross);
      }
      this.pressed = { isDrag: true };
    }
    key(event) {
      const ways = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
      if (!this.whole || event.ctrlKey || event.metaKey || event.altKey) return;
      if (!this.cross) this.cross = this.snapped(this.x, this.y);
      const way = ways[event.key], step = this.step() * (event.shiftKey ? 10 : 1);
      if (way) {
        const [left, top, right, bottom] = this.bounds();
        this.cross = [Math.min(Math.max(this.cross[0] + way[0] * step, left), right), Math.min(Math.max(this.cross[1] + way[1] * step, top), bottom)];
      }
      else if (event.key === "Enter" || event.key === " ") this.pick(...this.cross = this.snapped(...this.cross));
      else if (event.key === "+" || event.key === "=") this.zoom(1.5, ...this.toScreen(...this.cross));
      else if (event.key === "-") this.zoom(1 / 1.5, ...this.toScreen(...this.cross));
      else if (event.key === "0") this.fit();
      else if (event.key === "PageDown") choose(shown.image + 1);
      else if (event.key === "PageUp") choose(shown.image - 1);
      else if (event.key === "k" || event.key === "K") keep();
      else return;
      event.preventDefault();
      this.isKeyed = true;
      const [px, py] = this.toScreen(...this.cross), room = 24;
      if (px < room || py < room || px > this.width - room || py > this.height - room) [this.x, this.y] = this.cross;
      this.readout.textContent = this.tell(...this.cross);
      this.changed();
      if (way) sayWhenStill(() => "Cross at " + this.tell(...this.cross));
    }
    draw() {
      if (this.isDrawing) return;
      this.isDrawing = true;
      requestAnimationFrame(() => {
        this.isDrawing = false;
        const ratio = devicePixelRatio || 1, c = this.context;
        c.setTransform(ratio, 0, 0, ratio, 0, 0);
        c.fillStyle = colours.stage;
        c.fillRect(0, 0, this.width, this.height);
        if (this.whole) {
          this.paint(c);
          if (this.isKeyed && this.cross) this.drawCross(c);
        }
      });
    }
    drawCross(c) {
      const [px, py] = this.toScreen(...this.cross), gap = 7;
      for (const [width, colour] of [[3.5, colours.halo], [1.4, colours.fix]]) {
        c.lineWidth = width;
        c.strokeStyle = colour;
        c.beginPath();
        for (const [a, b, x, y] of [[0, py, px - gap, py], [px + gap, py, this.width, py], [px, 0, px, py - gap], [px, py + gap, px, this.height]]) { c.moveTo(a, b); c.lineTo(x, y); }
        c.stroke();
      }
    }
    // Lines through points of the world; `null` interrupts them.
    trace(c, points, isClosed) {
      let isOpen = false;
      c.beginPath();
      for (const point of points) {
        if (!point) { isOpen = false; continue; }
        const [px, py] = this.toScreen(...point);
        if (isOpen) c.lineTo(px, py); else c.moveTo(px, py);
        isOpen = true;
      }
      if (isClosed && points.every(Boolean)) c.closePath();
    }
    stroke(c, points, isClosed, width, colour, halo) {
      this.trace(c, points, isClosed);
      c.lineJoin = "round";
      if (halo) { c.lineWidth = width + halo; c.strokeStyle = colours.halo; c.globalAlpha = 0.75; c.stroke(); c.globalAlpha = 1; }
      c.lineWidth = width;
      c.strokeStyle = colour;
      c.stroke();
    }
    dot(c, point, radius, colour, isFilled) {
      const [px, py] = this.toScreen(...point);
      c.beginPath();
      c.arc(px, py, radius, 0, 7);
      c.lineWidth = 4.5;
      c.strokeStyle = colours.halo;
      c.stroke();
      if (isFilled) { c.fillStyle = colour; c.fill(); c.lineWidth = 1.5; c.strokeStyle = "#fff"; c.stroke(); return; }
      c.lineWidth = 2.5;
      c.strokeStyle = colour;
      c.stroke();
    }
  }

  // Pictures that arrive later.
  function load(url, arrived, failed) {
    const picture = new Image();
    picture.onload = () => arrived(picture);
    picture.onerror = () => failed && failed();
    picture.src = url;
    return picture;
  }

  // The image: columns and rows of the camera.
  const image = new Stage(byId("image-canvas"), {
    least: 0.5, most: 64, readout: byId("image-readout"), base: null, part: null,
    tell: (u, v) => "column " + u.toFixed(1) + ", row " + v.toFixed(1),
    step: () => 1,
    bounds() { const [left, top, right, bottom] = this.whole; return [left, top, right, bottom]; },
    snapped(u, v) {
      const [left, top, right, bottom] = this.whole, finer = this.scale > 8 ? 100 : 10;
      const round = (x, low, high) => Math.min(Math.max(Math.round(x * finer) / finer, low), high);
      return [round(u, left, right), round(v, top, bottom)];
    },
    pick: (u, v) => askPixel(u, v),
    settled() {
      const one = shown.images[shown.image];
      if (!one || one.reason || !this.whole || !this.base) return;
      const ratio = devicePixelRatio || 1;
      if (this.scale * ratio < 1.15 * this.base.naturalWidth / one.width || this.base.naturalWidth >= one.width) return;
      const [left, top] = this.toWorld(0, 0), [right, bottom] = this.toWorld(this.width, this.height);
      const box = [Math.max(Math.floor(left), 0), Math.max(Math.floor(top), 0), Math.min(Math.ceil(right) + 1, one.width), Math.min(Math.ceil(bottom) + 1, one.height)];
      if (box[2] <= box[0] || box[3] <= box[1] || (this.part && this.part.box.join() === box.join())) return;
      const across = Math.ceil(Math.min((box[2] - box[0]) * Math.min(this.scale * ratio, 1), 2400)), number = shown.image;
      load(pictureOf(number, across) + "&box=" + box.join(), (picture) => {
        if (number === shown.image) { this.part = { box, picture }; this.draw(); }
      });
    },
    paint(c) {
      const one = shown.images[shown.image];
      const [left, top] = this.toScreen(-0.5, -0.5), [right, bottom] = this.toScreen(one.width - 0.5, one.height - 0.5);
      c.imageSmoothingQuality = "high";
      c.imageSmoothingEnabled = this.scale * (devicePixelRatio || 1) < 4;
      if (this.base) c.drawImage(this.base, left, top, right - left, bottom - top);
      else {
        c.fillStyle = colours.card;
        c.fillRect(left, top, right - left, bottom - top);
        this.grid(c, one, left, top, right, bottom);
      }
      if (this.part) {
        const box = this.part.box, a = this.toScreen(box[0] - 0.5, box[1] - 0.5), b = this.toScreen(box[2] - 0.5, box[3] - 0.5);
        c.drawImage(this.part.picture, a[0], a[1], b[0] - a[0], b[1] - a[1]);
      }
      c.lineWidth = 1;
      c.strokeStyle = colours.grid;
      c.strokeRect(left, top, right - left, bottom - top);
      for (const mark of one.marks || []) this.dot(c, mark, 4, colours.sight, false);
      for (const kept of shown.kept) if (kept.image === shown.image && kept.u !== null) this.dot(c, [kept.u, kept.v], 4, colours.fix, true);
      const point = shown.point;
      if (!point || point.image !== shown.image || point.u === null) return;
      if (point.ellipse_uv) {
        const ring = point.ellipse_uv.map((uv) => uv[0] === null ? null : uv);
        if (ring.every(Boolean)) { this.trace(c, ring, true); c.fillStyle = colours.fix; c.globalAlpha = 0.16; c.fill(); c.globalAlpha = 1; }
        this.stroke(c, ring, true, 2, colours.fix, 2);
      }
      this.dot(c, [point.u, point.v], 6, colours.fix, point.is_fix);
    },
    grid(c, one, left, top, right, bottom) {
      const far = 90 / this.scale, power = Math.pow(10, Math.floor(Math.log10(far)));
      const step = [1, 2, 5, 10].map((k) => k * power).find((k) => k >= far);
      c.strokeStyle = colours.grid;
      c.fillStyle = colours.muted;
      c.font = "11px system-ui, sans-serif";
      c.lineWidth = 1;
      c.beginPath();
      for (let u = 0; u < one.width; u += step) { const [px] = this.toScreen(u, 0); c.moveTo(px, top); c.lineTo(px, bottom); c.fillText(String(u), px + 3, Math.max(top, 0) + 12); }
      for (let v = 0; v < one.height; v += step) { const [, py] = this.toScreen(0, v); c.moveTo(left, py); c.lineTo(right, py); if (v) c.fillText(String(v), Math.max(left, 0) + 3, py - 3); }
      c.stroke();
    },
  });
  const pictureOf = (number, across) => "image?image=" + number + "&across=" + across + "&edition=" + shown.edition;

  // The map: metres east and south of its middle.
  const map = new Stage(byId("map-canvas"), {
    least: 0.25, most: 400, readout: byId("map-readout"), reliefs: [], tiles: new Map(),
    toMap(lat, lon) {
      const [lon0, lat0] = shown.middle, [east, north] = shown.map.metres;
      return [(((lon - lon0) % 360 + 540) % 360 - 180) * east, (lat0 - lat) * north];
    },
    toPlace(x, y) {
      const [lon0, lat0] = shown.middle, [east, north] = shown.map.metres;
      return [Math.min(Math.max(lat0 - y / north, -90), 90), ((lon0 + x / east + 540) % 360 + 360) % 360 - 180];
    },
    tell(x, y) {
      const [lat, lon] = this.toPlace(x, y), places = Math.min(Math.max(Math.ceil(Math.log10(this.scale * 111000)), 4), 7);
      return degrees(lat, "N", "S", places) + ", " + degrees(lon, "E", "W", places);
    },
    step() { return 1 / this.scale; },
    bounds() { return [-Infinity, -Infinity, Infinity, Infinity]; },
    snapped(x, y) {
      const [lat, lon] = this.toPlace(x, y);
      return this.toMap(Number(lat.toFixed(7)), Number(lon.toFixed(7)));
    },
    pick(x, y) { const [lat, lon] = this.toPlace(x, y); askPlace(Number(lat.toFixed(7)), Number(lon.toFixed(7))); },
    settled() {
      if (!this.whole || !shown.map || !shown.map.between || !this.reliefs.length) return;
      const [left, top] = this.toWorld(0, 0), [right, bottom] = this.toWorld(this.width, this.height);
      const first = this.reliefs[0], ratio = devicePixelRatio || 1;
      if (this.scale * ratio < 1.3 * first.picture.naturalWidth / (first.box[2] - first.box[0])) { this.reliefs.length = 1; return; }
      const room = 0.15, across = (right - left) * room, down = (bottom - top) * room;
      const [north, west] = this.toPlace(left - across, top - down), [south, east] = this.toPlace(right + across, bottom + down);
      const box = [west, south, east < west ? east + 360 : east, north].map((x) => x.toFixed(7)).join();
      if (this.reliefs.some((one) => one.name === box)) return;
      load("relief?box=" + box + "&edition=" + shown.edition, (picture) => {
        this.reliefs = [first, { name: box, picture, box: [left - across, top - down, right + across, bottom + down] }];
        this.draw();
      });
    },
    paint(c) {
      c.imageSmoothingEnabled = true;
      c.imageSmoothingQuality = "high";
      if (shown.tiles) this.paintTiles(c);
      else {
        c.globalAlpha = Number(colours.veil) || 1;
        for (const one of this.reliefs) {
          const a = this.toScreen(one.box[0], one.box[1]), b = this.toScreen(one.box[2], one.box[3]);
          c.drawImage(one.picture, a[0], a[1], b[0] - a[0], b[1] - a[1]);
        }
        c.globalAlpha = 1;
      }
      this.graticule(c);
      const of = shown.outlines, one = shown.images[shown.image];
      of.forEach((ring, i) => {
        if (i === shown.image) return;
        if (of.length <= 60) this.stroke(c, ring, true, 1, colours.edge, 1.6);
        else { c.globalAlpha = Math.max(60 / of.length, 0.14); this.stroke(c, ring, true, 1, colours.edge, 0); c.globalAlpha = 1; }
      });
      const small = of.length > 60 ? 1.8 : 4;
      shown.cameras.forEach((at, i) => { if (i !== shown.image) { const [px, py] = this.toScreen(...at); c.beginPath(); c.arc(px, py, small, 0, 7); c.fillStyle = colours.sight; c.fill(); c.lineWidth = 1; c.strokeStyle = colours.halo; c.stroke(); } });
      if (of[shown.image]) this.stroke(c, of[shown.image], true, 2.2, colours.edge, 3);
      const camera = shown.cameras[shown.image], point = shown.point;
      for (const kept of shown.kept) if (kept.lat !== null) this.dot(c, this.toMap(kept.lat, kept.lon), 4, colours.fix, true);
      if (point && point.lat !== null && point.lat !== undefined) {
        const at = this.toMap(point.lat, point.lon);
        if (point.image === shown.image && point.is_fix) this.stroke(c, [camera, at], false, 2, colours.sight, 2.5);
        if (point.ellipse) {
          const ring = point.ellipse.map(([lat, lon]) => this.toMap(lat, lon));
          this.trace(c, ring, true);
          c.fillStyle = colours.fix;
          c.globalAlpha = 0.16;
          c.fill();
          c.globalAlpha = 1;
          this.stroke(c, ring, true, 2, colours.fix, 2);
        }
        this.dot(c, at, 6, colours.fix, point.is_fix);
      }
      if (one) this.drawCamera(c, camera);
      this.scaleBar(c);
    },
    drawCamera(c, at) {
      const [px, py] = this.toScreen(...at), r = 8;
      c.beginPath();
      c.moveTo(px, py - r);
      c.lineTo(px + 0.87 * r, py + 0.6 * r);
      c.lineTo(px - 0.87 * r, py + 0.6 * r);
      c.closePath();
      c.lineJoin = "round";
      c.lineWidth = 4.5;
      c.strokeStyle = colours.halo;
      c.stroke();
      c.fillStyle = colours.sight;
      c.fill();
      c.lineWidth = 1.3;
      c.strokeStyle = "#fff";
      c.stroke();
    },
    graticule(c) {
      const [east, north] = shown.map.metres, steps = [1, 2, 5];
      const nice = (far) => { const power = Math.pow(10, Math.floor(Math.log10(far))); return [...steps, 10].map((k) => k * power).find((k) => k >= far); };
      const [n, w] = this.toPlace(...this.toWorld(0, 0)), [s, e0] = this.toPlace(...this.toWorld(this.width, this.height));
      const e = e0 < w ? e0 + 360 : e0, across = nice(150 / this.scale / east), down = nice(110 / this.scale / north);
      const places = (step) => Math.max(0, Math.ceil(-Math.log10(step) - 1e-9));
      c.strokeStyle = colours.ink;
      c.lineWidth = 1;
      c.font = "11px system-ui, sans-serif";
      const label = (words, px, py) => { c.lineWidth = 3; c.strokeStyle = colours.halo; c.globalAlpha = 0.8; c.strokeText(words, px, py); c.globalAlpha = 1; c.fillStyle = colours.ink; c.fillText(words, px, py); c.lineWidth = 1; c.strokeStyle = colours.ink; };
      const line = (a, b) => { c.globalAlpha = 0.16; c.beginPath(); c.moveTo(...a); c.lineTo(...b); c.stroke(); c.globalAlpha = 1; };
      for (let k = Math.ceil(w / across); k * across < e; k++) {
        const [px] = this.toScreen(...this.toMap(0, k * across));
        line([px, 0], [px, this.height]);
        if (px < this.width - 70) label(degrees((k * across + 540) % 360 - 180, "E", "W", places(across)), px + 3, 12);
      }
      for (let k = Math.ceil(s / down); k * down < n; k++) {
        const [, py] = this.toScreen(...this.toMap(k * down, shown.middle[0]));
        line([0, py], [this.width, py]);
        if (py > 26 && py < this.height - 40) label(degrees(k * down, "N", "S", places(down)), 4, py - 3);
      }
    },
    scaleBar(c) {
      const far = 110 / this.scale, power = Math.pow(10, Math.floor(Math.log10(far)));
      const long = [5, 2, 1].map((k) => k * power).find((k) => k <= far), wide = long * this.scale, y = this.height - 14;
      const words = long >= 1000 ? long / 1000 + " km" : long >= 1 ? long + " m" : Math.round(long * 100) + " cm";
      c.font = "600 12px system-ui, sans-serif";
      c.fillStyle = colours.card;
      c.globalAlpha = 0.86;
      c.fillRect(8, y - 21, wide + 16, 29);
      c.globalAlpha = 1;
      c.fillStyle = colours.ink;
      c.fillText(words, 16, y - 7);
      c.fillRect(16, y - 2, wide, 3);
    },
    paintTiles(c) {
      const [n, w] = this.toPlace(...this.toWorld(0, 0)), [s, e0] = this.toPlace(...this.toWorld(this.width, this.height)), e = e0 < w ? e0 + 360 : e0;
      const per = 156543.034 * Math.cos(shown.middle[1] * Math.PI / 180);
      let z = Math.min(Math.max(Math.round(Math.log2(per * this.scale)), 0), 19);
      const row = (lat, z) => { const a = Math.min(Math.max(lat, -85.05), 85.05) * Math.PI / 180; return (1 - Math.asinh(Math.tan(a)) / Math.PI) / 2 * 2 ** z; };
      const column = (lon, z) => (lon + 180) / 360 * 2 ** z;
      while (z > 0 && (column(e, z) - column(w, z) + 1) * (row(s, z) - row(n, z) + 1) > 80) z--;
      const latOf = (y) => Math.atan(Math.sinh(Math.PI * (1 - 2 * y / 2 ** z))) * 180 / Math.PI, lonOf = (x) => x / 2 ** z * 360 - 180;
      for (let x = Math.floor(column(w, z)); x <= column(e, z); x++)
        for (let y = Math.max(Math.floor(row(n, z)), 0); y <= Math.min(row(s, z), 2 ** z - 1); y++) {
          const wrapped = ((x % 2 ** z) + 2 ** z) % 2 ** z, url = shown.tiles.replaceAll("{z}", z).replaceAll("{x}", wrapped).replaceAll("{y}", y);
          if (!this.tiles.has(url)) {
            this.tiles.set(url, null);
            if (this.tiles.size > 400) this.tiles.delete(this.tiles.keys().next().value);
            load(url, (picture) => { this.tiles.set(url, picture); this.draw(); });
          }
          const picture = this.tiles.get(url);
          if (!picture) continue;
          const a = this.toScreen(...this.toMap(latOf(y), lonOf(x))), b = this.toScreen(...this.toMap(latOf(y + 1), lonOf(x + 1)));
          const left = Math.floor(a[0]), top = Math.floor(a[1]);
          c.drawImage(picture, left, top, Math.ceil(b[0]) - left, Math.ceil(b[1]) - top);
        }
    },
  });

  const degrees = (x, plus, minus, places) => Math.abs(x).toFixed(places) + "° " + (x >= 0 ? plus : minus);

  // Answers of the server.
  async function get(url, stop) {
    const response = await fetch(url, { signal: stop && stop.signal });
    const content = await response.json();
    if (!response.ok) throw new Error(content.error || response.statusText);
    return content;
  }
  function begin() {
    if (asking) asking.abort();
    asking = new AbortController();
    return asking;
  }
  function complain(error) {
    if (error.name === "AbortError") return;
    const words = error instanceof TypeError ? "The viewer has ended; start jaxgeo view again." : error.message;
    shown.point = null;
    show({ asked: "No answer", label: "Error", sentence: words, isBad: true });
    say(words);
  }

  async function askPixel(u, v) {
    const number = shown.image, one = shown.images[number], stop = begin();
    Object.assign(byId("u"), { value: String(u) });
    Object.assign(byId("v"), { value: String(v) });
    for (const id of ["lat", "lon"]) byId(id).value = "";
    shown.point = { image: number, u, v, lat: null, is_fix: false };
    image.cross = [u, v];
    const asked = "Pixel " + u + ", " + v + " of " + one.name;
    show({ asked, isWaiting: true, headline: shown.map ? "…" : "Preparing …" });
    const query = "api/locate?image=" + number + "&u=" + u + "&v=" + v;
    try {
      await mapShown;
      if (stop.signal.aborted) return;
      const fix = await get(query + "&accuracy=no", stop);
      placeFix(fix, asked);
      if (!fix.is_fix) return;
      const more = [get("api/project?image=" + number + "&lat=" + fix.fix_lat_deg + "&lon=" + fix.fix_lon_deg, stop).then(showSeen)];
      if (shown.map.has_errors) more.push(get(query, stop).then((full) => placeFix(full, asked, true)));
      await Promise.all(more);
    } catch (error) { complain(error); }
  }

  function placeFix(fix, asked, isWhole) {
    const lat = fix.fix_lat_deg ?? null, lon = fix.fix_lon_deg ?? null;
    shown.point = { image: fix.image, u: fix.u, v: fix.v, lat, lon, height: fix.fix_height_m ?? fix.fix_height_above_takeoff_m, height_column: "fix_height_m" in fix ? "fix_height_m" : "fix_height_above_takeoff_m", is_fix: fix.is_fix, ellipse: fix.ellipse, ellipse_uv: fix.ellipse_uv, ce: fix.circular_m ?? null, asked, status: fix.status };
    if (lat !== null && fix.is_fix) {
      byId("lat").value = lat.toFixed(7);
      byId("lon").value = lon.toFixed(7);
      map.cross = map.toMap(lat, lon);
    }
    const heading = lat !== null && fix.is_fix ? [fix.lat_text, fix.lon_text] : fix.label;
    const more = lat === null || !fix.is_fix ? [] : [fix.height_text, ...(fix.msl_text ? [fix.msl_text] : [])];
    const sentence = fix.is_fix ? (fix.ellipse_text ? fix.ellipse_text + "." : "") : fix.status_text + (lat !== null ? " The open ring on the map is the point of the line of sight from which the ground is unknown." : "");
    show({ asked, label: fix.label, isBad: !fix.is_fix, headline: heading, more, sentence, fix, isWaiting: fix.is_fix && shown.map.has_errors && !isWhole });
    keepInView(map, lat === null ? null : map.toMap(lat, lon));
    speak(asked, fix);
  }

  async function askPlace(lat, lon) {
    const number = shown.image, one = shown.images[number], stop = begin();
    byId("lat").value = lat.toFixed(7);
    byId("lon").value = lon.toFixed(7);
    for (const id of ["u", "v"]) byId(id).value = "";
    shown.point = { image: number, u: null, v: null, lat, lon, is_fix: false };
    map.cross = map.toMap(lat, lon);
    const asked = degrees(lat, "N", "S", 7) + ", " + degrees(lon, "E", "W", 7);
    show({ asked, isWaiting: true, headline: "…" });
    try {
      const seen = await get("api/project?image=" + number + "&lat=" + lat + "&lon=" + lon, stop);
      const isSeen = seen.status === "hit";
      Object.assign(shown.point, { u: seen.u, v: seen.v, height: seen.height_m, height_column: seen.above === "above the take-off" ? "fix_height_above_takeoff_m" : "fix_height_m", is_fix: isSeen, status: seen.status, asked });
      if (seen.u !== null && seen.status !== "outside_image") {
        byId("u").value = seen.u.toFixed(2);
        byId("v").value = seen.v.toFixed(2);
        image.cross = [seen.u, seen.v];
        keepInView(image, image.cross);
      }
      const headline = isSeen ? ["column " + seen.u.toFixed(2), "row " + seen.v.toFixed(2)] : "Not visible in this image";
      const more = seen.height_m === null ? [] : ["ground " + seen.height_m.toFixed(2) + " m " + seen.above, isSeen ? "in " + one.name : ""];
      const place = { asked, label: seen.label, isBad: !isSeen, headline, more, sentence: isSeen ? "" : seen.status_text };
      show({ ...place, isWaiting: isSeen && shown.map.has_errors });
      showSeen(seen);
      say(isSeen ? "In " + one.name + " at column " + seen.u.toFixed(1) + ", row " + seen.v.toFixed(1) : "Not visible: " + seen.status_text);
      if (!isSeen || !shown.map.has_errors) return;
      const fix = await get("api/locate?image=" + number + "&u=" + seen.u + "&v=" + seen.v, stop);
      Object.assign(shown.point, { ellipse: fix.ellipse, ellipse_uv: fix.ellipse_uv, ce: fix.circular_m ?? null });
      const size = extent(fix.ellipse_uv);
      show({ ...place, fix, sentence: fix.ellipse_text + (size ? "; in the image it spans " + size + "." : ".") });
      say("Column " + seen.u.toFixed(1) + ", row " + seen.v.toFixed(1) + spokenAccuracy(fix));
    } catch (error) { complain(error); }
  }

  function extent(ring) {
    const known = (ring || []).filter((uv) => uv[0] !== null);
    if (known.length < 3 || known.length < ring.length) return "";
    const span = (k) => Math.max(...known.map((uv) => uv[k])) - Math.min(...known.map((uv) => uv[k]));
    return span(0).toPrecision(3) * 1 + " columns by " + span(1).toPrecision(3) * 1 + " rows";
  }
  const spokenAccuracy = (fix) => fix.circular_text ? ", CE" + shown.map.percent + " " + fix.circular_text : "";
  function speak(asked, fix) {
    say(fix.is_fix ? asked + " is at " + fix.lat_text + ", " + fix.lon_text + ", " + fix.height_text + spokenAccuracy(fix) : asked + ": no fix. " + fix.status_text);
  }
  function keepInView(stage, at) {
    const [left, top, right, bottom] = stage.whole;
    if (at && (stage === map || (at[0] >= left && at[0] <= right && at[1] >= top && at[1] <= bottom))) {
      const [px, py] = stage.toScreen(...at);
      if (px < 8 || py < 8 || px > stage.width - 8 || py > stage.height - 8) [stage.x, stage.y] = at;
    }
    stage.changed();
  }

  // The result below the two panes.
  function spans(element, words) {
    element.replaceChildren(...(Array.isArray(words) ? words : [words]).filter(Boolean).map((word) => Object.assign(document.createElement("span"), { textContent: word })));
  }
  function show(answer) {
    const badge = byId("badge"), fix = answer.fix || {};
    text("asked", answer.asked || "");
    badge.hidden = !answer.label || answer.label === answer.headline;
    badge.textContent = answer.label || "";
    badge.classList.toggle("bad", Boolean(answer.isBad));
    spans(byId("headline"), answer.headline || "");
    byId("headline").hidden = !answer.headline;
    spans(byId("more"), answer.more || []);
    text("sentence", answer.sentence || "");
    byId("result").classList.toggle("none", Boolean(answer.isBad));
    byId("figures").hidden = Boolean(answer.isBad) || (!answer.fix && !answer.isWaiting);
    const waiting = answer.isWaiting ? "…" : "–";
    for (const [id, value] of [["ce", fix.circular_text], ["le", fix.linear_text], ["range", fix.range_text]]) {
      text(id, value || waiting);
      byId(id).classList.toggle("waiting", !value);
    }
    const isUnsure = shown.map && !shown.map.has_errors;
    text("because", answer.isBad ? "" : fix.accuracy_text || (answer.isWaiting && !isUnsure ? "Estimating the accuracy …" : answer.fix && isUnsure ? "The accuracy is unknown: no standard deviations are stated. Give --position-sigma, --attitude-sigma or --gimbal-sigma." : ""));
    const has = Boolean(shown.point && shown.point.lat !== null && shown.point.is_fix);
    for (const id of ["keep", "copy", "to-fix"]) byId(id).disabled = !has;
    byId("acts").hidden = !shown.point || Boolean(answer.isBad);
    if (!answer.fix || answer.isBad) byId("seen-block").hidden = true;
    image.draw();
    map.draw();
  }
  const MOST_CHIPS = 12;
  function showSeen(seen) {
    const all = seen.seen, block = byId("seen-block"), many = shown.images.length;
    block.hidden = many < 2;
    text("seen-words", all.length ? "Visible in " + all.length + " of " + many + " images" + (all.length > MOST_CHIPS ? ", nearest cameras first:" : ":") : "Visible in none of the " + many + " images.");
    byId("seen").replaceChildren(...all.slice(0, MOST_CHIPS).map((one) => {
      const button = Object.assign(document.createElement("button"), { type: "button", textContent: shown.images[one.image].name });
      if (one.image === shown.image) button.setAttribute("aria-current", "true");
      button.addEventListener("click", () => { choose(one.image, true); askPlace(Number(seen.lat_deg.toFixed(7)), Number(seen.lon_deg.toFixed(7))); });
      return button;
    }));
  }

  // Points that are kept, for a table and for files.
  function keep() {
    const point = shown.point;
    if (!point || point.lat === null || !point.is_fix) return;
    shown.kept.push({ ...point, name: shown.images[point.image].name, number: (shown.kept.at(-1)?.number ?? 0) + 1 });
    listKept();
    say("Point " + shown.kept.at(-1).number + " kept.");
  }
  function listKept() {
    byId("kept-block").hidden = !shown.kept.length;
    byId("kept").replaceChildren(...shown.kept.map((one) => {
      const row = document.createElement("tr"), rest = document.createElement("button");
      for (const words of [one.number, one.name, one.u.toFixed(1), one.v.toFixed(1), one.lat.toFixed(7), one.lon.toFixed(7), one.height?.toFixed(2) ?? "", one.ce?.toFixed(2) ?? ""]) row.append(Object.assign(document.createElement("td"), { textContent: words }));
      Object.assign(rest, { type: "button", textContent: "×", title: "Remove" });
      rest.setAttribute("aria-label", "Remove point " + one.number);
      rest.addEventListener("click", () => { shown.kept = shown.kept.filter((other) => other !== one); listKept(); });
      const cell = document.createElement("td");
      cell.append(rest);
      row.append(cell);
      return row;
    }));
    image.draw();
    map.draw();
  }
  function save(name, kind, content) {
    const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(new Blob([content], { type: kind })), download: name });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 5000);
  }
  function columns(one) {
    return { point: one.number, name: one.name, u: one.u, v: one.v, fix_lat_deg: one.lat, fix_lon_deg: one.lon, [one.height_column]: one.height, ["ce" + shown.map.percent.replace(".", "_") + "_m"]: one.ce };
  }
  function saveCsv() {
    const rows = shown.kept.map(columns), cell = (x) => /[",\n]/.test(String(x ?? "")) ? '"' + String(x).replaceAll('"', '""') + '"' : String(x ?? "");
    save("points.csv", "text/csv", [Object.keys(rows[0]).join(), ...rows.map((row) => Object.values(row).map(cell).join())].join("\n") + "\n");
  }
  function saveGeoJson() {
    const features = shown.kept.map((one) => ({ type: "Feature", geometry: { type: "Point", coordinates: [one.lon, one.lat] }, properties: columns(one) }));
    save("points.geojson", "application/geo+json", JSON.stringify({ type: "FeatureCollection", features }, null, 1));
  }

  // Which image is shown.
  function choose(number, keepsPoint) {
    if (!(number >= 0 && number < shown.images.length)) return;
    const isNew = number !== shown.image || !image.whole, one = shown.images[number];
    shown.image = number;
    byId("image").value = String(number);
    byId("before").disabled = number === 0;
    byId("next").disabled = number === shown.images.length - 1;
    text("count", number + 1 + " of " + shown.images.length);
    if (!isNew) return;
    Object.assign(image, { base: null, part: null, cross: null });
    image.canvas.setAttribute("aria-label", "Image " + one.name + ", " + one.width + " columns, " + one.height + " rows");
    image.setWhole(-0.5, -0.5, one.width - 0.5, one.height - 0.5);
    const message = byId("image-message");
    message.hidden = !one.reason;
    message.textContent = one.reason || "";
    if (!one.reason)
      load(pictureOf(number, Math.min(Math.ceil(image.width * (devicePixelRatio || 1)) + 400, 2400)), (picture) => {
        if (number === shown.image) { image.base = picture; image.changed(); }
      }, () => get(pictureOf(number, 100)).catch((error) => { if (number === shown.image) { one.reason = error.message; message.hidden = false; message.textContent = error.message; } }));
    if (!keepsPoint && shown.point) {
      shown.point = null;
      show({ asked: "Choose a pixel in the image, or a place on the map." });
    }
    map.draw();
  }

  // Preparing.
  let hasBegun = false;
  async function prepare() {
    const words = byId("state-text"), block = byId("state");
    for (;;) {
      let state;
      try { state = await get("api/state"); } catch { words.textContent = "The viewer has ended; start jaxgeo view again."; block.className = "error"; return; }
      if (state.error) { words.textContent = state.error; block.className = "error"; return; }
      if (state.has_images && !shown.images.length) await showImages();
      if (state.has_map && !shown.map) await showMap();
      words.textContent = state.is_warm ? "Ready" : "Preparing: " + state.doing;
      if (state.is_ready && !hasBegun && (hasBegun = true) && !shown.point && shown.images[shown.image].marks.length) askPixel(...shown.images[shown.image].marks[0]);
      if (state.is_warm) { block.className = "done"; document.documentElement.dataset.ready = "yes"; return; }
      await new Promise((later) => setTimeout(later, 300));
    }
  }
  async function showImages() {
    const scene = await get("api/scene");
    Object.assign(shown, { images: scene.images, edition: scene.edition, tiles: scene.tiles });
    text("title", scene.title);
    document.title = scene.title + " – jaxgeo view";
    byId("image").replaceChildren(...scene.images.map((one, i) => Object.assign(document.createElement("option"), { value: String(i), textContent: one.name })));
    choose(0);
    document.documentElement.dataset.images = "yes";
  }
  async function showMap() {
    const found = await get("api/map"), scene = await get("api/scene"), [west, south, east, north] = found.box;
    shown.middle = [(west + east) / 2, (south + north) / 2];
    shown.map = found;
    shown.outlines = found.outlines.map((ring) => ring.map(([lat, lon]) => lat === null ? null : map.toMap(lat, lon)));
    shown.cameras = shown.images.map((one) => map.toMap(one.lat_deg, one.lon_deg));
    const [left, top] = map.toMap(north, west), [right, bottom] = map.toMap(south, east);
    map.setWhole(left, top, right, bottom);
    map.canvas.setAttribute("aria-label", "Map of the footprints of " + shown.images.length + " images");
    text("ce-name", "CE" + found.percent);
    text("le-name", "LE" + found.percent);
    text("ce-head", "CE" + found.percent + ", m");
    text("ring-name", found.percent + " % error ellipse, or circle of samples");
    const heights = found.between ? ", relief from " + Math.round(found.between[0]) + " to " + Math.round(found.between[1]) + " m above the WGS 84 ellipsoid" : "";
    text("ground", "The ground is the " + found.ground + heights + "." + (shown.tiles ? " Web-map tiles: " + new URL(shown.tiles.replace(/[{}]/g, "")).hostname + "." : ""));
    text("map-name", shown.tiles ? "Map, tiles of " + new URL(shown.tiles.replace(/[{}]/g, "")).hostname : "Map");
    byId("notes").replaceChildren(...scene.notes.map((note) => Object.assign(document.createElement("li"), { textContent: note })));
    if (found.between && !shown.tiles)
      load("relief?box=" + found.box.join() + "&edition=" + shown.edition, (picture) => { map.reliefs = [{ name: "", picture, box: [left, top, right, bottom] }]; map.changed(); });
    byId("map-message").hidden = true;
    document.documentElement.dataset.map = "yes";
    mapIsShown();
  }

  // Forms and buttons. Numbers may be typed with a comma, and both coordinates into the first field.
  const SIDES = { n: 1, e: 1, s: -1, w: -1 };
  function numberIn(words) {
    const found = /^\s*([-+]?\d+(?:[.,]\d+)?(?:e[-+]?\d+)?)\s*(?:°|deg)?\s*([nesw])?\s*$/i.exec(words);
    return found ? Number(found[1].replace(",", ".")) * (found[2] ? SIDES[found[2].toLowerCase()] : 1) : NaN;
  }
  function form(id, names, ask, check) {
    byId(id).addEventListener("submit", (event) => {
      event.preventDefault();
      const [first, second] = names.map(byId), both = first.value.split(/\s*[,;]\s+|\s*;\s*/);
      if (both.length === 2) [first.value, second.value] = both;
      const numbers = [first, second].map((one) => numberIn(one.value)), wrong = check(...numbers);
      for (const [i, one] of [first, second].entries()) one.setAttribute("aria-invalid", String(Number.isNaN(numbers[i])));
      if (wrong) { shown.point = null; show({ asked: "Not understood", label: "Error", sentence: wrong, isBad: true }); say(wrong); return; }
      ask(...numbers);
    });
  }
  form("pixel-form", ["u", "v"], (u, v) => { askPixel(u, v); keepInView(image, [u, v]); }, (u, v) => Number.isNaN(u + v) ? "Give column and row as numbers, such as 1200 and 800.5." : image.whole ? "" : "The images are being prepared.");
  form("place-form", ["lat", "lon"], (lat, lon) => { askPlace(lat, lon); keepInView(map, map.toMap(lat, lon)); }, (lat, lon) => Number.isNaN(lat + lon) ? "Give latitude and longitude in degrees, such as 36.3125 and -84.2571." : Math.abs(lat) > 90 || Math.abs(lon) > 360 ? "Latitudes end at 90 degrees, longitudes at 180." : shown.map ? "" : "The map is being prepared.");
  byId("image").addEventListener("change", (event) => choose(Number(event.target.value)));
  byId("before").addEventListener("click", () => choose(shown.image - 1));
  byId("next").addEventListener("click", () => choose(shown.image + 1));
  for (const button of document.querySelectorAll("[data-zoom]"))
    button.addEventListener("click", () => {
      const stage = button.dataset.stage === "map" ? map : image, factor = Number(button.dataset.zoom), at = stage.cross && shown.point ? stage.toScreen(...stage.cross) : [stage.width / 2, stage.height / 2];
      if (factor) stage.zoom(factor, ...at); else stage.fit();
    });
  byId("to-fix").addEventListener("click", () => {
    const point = shown.point, [x, y] = map.toMap(point.lat, point.lon);
    const ring = (point.ellipse || []).map(([lat, lon]) => map.toMap(lat, lon));
    const half = Math.max(15, ...ring.map((at) => 2.5 * Math.hypot(at[0] - x, at[1] - y)));
    map.show(x - half, y - half, x + half, y + half);
  });
  byId("because").addEventListener("click", (event) => event.target.classList.toggle("whole"));
  byId("keep").addEventListener("click", keep);
  byId("copy").addEventListener("click", async () => {
    const point = shown.point, words = point.lat.toFixed(7) + ", " + point.lon.toFixed(7);
    try { await navigator.clipboard.writeText(words); say("Copied."); text("copy", "Copied"); } catch { text("copy", words); }
    setTimeout(() => text("copy", "Copy coordinates"), 1500);
  });
  byId("save-csv").addEventListener("click", saveCsv);
  byId("save-geojson").addEventListener("click", saveGeoJson);
  dark.addEventListener("change", () => { readColours(); image.draw(); map.draw(); });
  readColours();
  prepare();
  window.jaxgeoView = { shown, image, map };  // for tests
})();
