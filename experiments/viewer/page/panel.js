// A panel: one episode over its floor, and what each robot is served in the slot that is shown.

const SVG = "http://www.w3.org/2000/svg";

function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

function shape(name, attributes = {}, ...children) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

const number = (value, digits) => value === null ? "-" : Number(value).toFixed(digits);

// The floor: the radio map as pixels, and above it a drawing in metres whose y grows downwards.
class Floor {
  constructor(scene, large) {
    this.scene = scene;
    const [width, depth] = scene.size_m;
    const unit = Math.max(width, depth) / (large ? 30 : 18);  // of marks
    this.svg = shape("svg", { viewBox: `0 0 ${width} ${depth}`, "aria-hidden": "true" });
    this.box = element("div", { class: "floor" }, this.map(), this.svg);
    this.box.style.aspectRatio = `${width} / ${depth}`;
    for (const [x0, y0, x1, y1] of scene.walls) {
      this.svg.append(shape("line", {
        x1: x0, y1: depth - y0, x2: x1, y2: depth - y1,
        stroke: "#000", "stroke-width": unit * .28, "stroke-linecap": "square",
      }));
    }
    const star = this.at(scene.ap), half = unit * .55;
    this.svg.append(shape("polygon", {
      points: `${star[0] - half},${star[1] + half} ${star[0] + half},${star[1] + half} ${star[0]},${star[1] - half}`,
      fill: "#00b894", stroke: "#000", "stroke-width": unit * .08,
    }));
    if (scene.ris) {
      const [x, y] = this.at(scene.ris);
      this.svg.append(shape("rect", {
        x: x - half, y: y - half, width: 2 * half, height: 2 * half,
        fill: "#00cec9", stroke: "#000", "stroke-width": unit * .08,
      }));
    }
    scene.destinations.forEach((cell, robot) => this.svg.append(shape("path", {
      d: star5(...this.centre(cell), unit * .75), fill: this.colour(robot),
      stroke: "#000", "stroke-width": unit * .08,
    })));
    this.trails = scene.destinations.map((_, robot) => {
      const line = { fill: "none", "stroke-linejoin": "round", "stroke-linecap": "round" };
      const edge = shape("polyline", { ...line, stroke: "#fff", "stroke-width": unit * .34 });
      const trail = shape("polyline", { ...line, stroke: this.colour(robot), "stroke-width": unit * .2 });
      this.svg.append(edge, trail);
      return [edge, trail];
    });
    this.robots = scene.destinations.map((_, robot) => {
      const text = shape("text", {
        "text-anchor": "middle", "dominant-baseline": "central", "font-size": unit * .85,
        "font-weight": "bold", fill: "#fff", stroke: "#000", "stroke-width": unit * .16,
        "paint-order": "stroke",
      });
      text.textContent = large ? robot : "";
      const body = shape("circle", {
        r: unit * .62, fill: this.colour(robot), stroke: "#000", "stroke-width": unit * .1,
      });
      const group = shape("g", {}, body, text);
      this.svg.append(group);
      return group;
    });
  }

  colour(robot) { return this.scene.colours[robot % this.scene.colours.length]; }

  at([x, y]) { return [x, this.scene.size_m[1] - y]; }

  centre(cell) {
    const { columns, cell_m } = this.scene;
    return this.at([(cell % columns + .5) * cell_m, (Math.floor(cell / columns) + .5) * cell_m]);
  }

  map() {
    const { rows, columns } = this.scene, shades = atob(this.scene.map);
    const canvas = element("canvas", { width: columns, height: rows, "aria-hidden": "true" });
    const context = canvas.getContext("2d"), pixels = context.createImageData(columns, rows);
    for (let row = 0; row < rows; row++) {
      for (let column = 0; column < columns; column++) {
        const shade = shades.charCodeAt((rows - 1 - row) * columns + column);
        const at = 4 * (row * columns + column), grey = 40 + shade * 215 / 255;
        pixels.data.set(shade ? [grey, grey, grey, 255] : [201, 183, 156, 255], at);
      }
    }
    context.putImageData(pixels, 0, 0);
    return canvas;
  }

  // Robots where they are at a time in slots, with the ways that they have come.
  show(cells, time) {
    const slot = Math.min(Math.floor(time), cells.length - 1), part = time - slot;
    const next = cells[Math.min(slot + 1, cells.length - 1)];
    this.robots.forEach((group, robot) => {
      const [x0, y0] = this.centre(cells[slot][robot]), [x1, y1] = this.centre(next[robot]);
      const x = x0 + (x1 - x0) * part, y = y0 + (y1 - y0) * part;
      group.setAttribute("transform", `translate(${x} ${y})`);
      const way = cells.slice(0, slot + 1).map((each) => this.centre(each[robot]).join(","));
      const points = [...way, `${x},${y}`].join(" ");
      for (const line of this.trails[robot]) line.setAttribute("points", points);
    });
  }
}

function star5(x, y, radius) {
  const points = Array.from({ length: 10 }, (_, i) => {
    const r = i % 2 ? radius * .45 : radius, angle = Math.PI * (i / 5 - .5);
    return `${x + r * Math.cos(angle)},${y + r * Math.sin(angle)}`;
  });
  return `M${points.join("L")}Z`;
}

class Panel {
  constructor({ title, scene, episode }) {
    this.scene = scene;
    this.episode = episode;
    this.slots = episode.cells.length - 1;
    this.floor = new Floor(scene, true);
    this.floor.svg.removeAttribute("aria-hidden");
    this.floor.svg.setAttribute("role", "img");
    this.floor.svg.setAttribute("aria-label", `${title}: ${this.summary()}`);
    this.top = Math.max(1e-9, ...episode.rates.flat());
    this.rows = scene.destinations.map((_, robot) => this.row(robot));
    const head = element("tr", {}, ...["Robot", "Rate, bit/s/Hz", "Power, mW", "Decoded", "Channel"]
      .map((name) => element("th", { scope: "col" }, name)));
    const table = element("table", {}, element("thead", {}, head),
      element("tbody", {}, ...this.rows.map((row) => row.line)));
    this.tiles = element("div");
    const ris = element("div", { class: "ris" }, episode.beams ? "RIS: beam" : "RIS: phases", this.tiles);
    const below = element("div", { class: "below" }, table, scene.ris ? ris : "");
    this.box = element("article", { class: "panel" }, element("h2", {}, title), this.floor.box, below,
      element("p", { class: "measures" }, this.summary()));
    this.shown = -1;
  }

  summary() {
    const { success, ee, ee_bits_per_joule, slots } = this.episode, robots = this.scene.destinations.length;
    return `${Math.round(success * robots)} of ${robots} robots arrive, ${slots} slots, `
      + `energy efficiency ${number(ee, 4)} bit/s/Hz/J, ${number(ee_bits_per_joule, 3)} bit/J.`;
  }

  row(robot) {
    const bar = () => {
      const fill = element("i"), text = element("b");
      return { box: element("div", { class: "bar" }, fill, text), fill, text };
    };
    const rate = bar(), power = bar(), decoded = element("td"), gain = element("td");
    const mark = element("span", { class: "mark" }, String(robot));
    const line = element("tr", {}, element("th", { scope: "row" }, mark),
      element("td", {}, rate.box), element("td", {}, power.box), decoded, gain);
    line.style.setProperty("--colour", this.floor.colour(robot));
    return { line, rate, power, decoded, gain };
  }

  show(time) {
    const within = Math.min(time, this.slots);
    this.floor.show(this.episode.cells, within);
    const slot = Math.min(Math.floor(within), this.slots - 1);
    const ended = within >= this.slots;
    const key = ended ? this.slots : slot;
    if (key === this.shown) return;
    this.shown = key;
    this.rows.forEach((row, robot) => this.fill(row, robot, slot, ended));
    this.showRis(slot);
  }

  fill(row, robot, slot, ended) {
    const { driving, rates, powers_w, order, gains_db, cells } = this.episode;
    const drives = !ended && driving[slot][robot];
    const there = cells[Math.min(slot + (ended ? 1 : 0), this.slots)][robot] === this.scene.destinations[robot];
    const rate = drives ? rates[slot][robot] : 0, power = drives ? powers_w[slot][robot] : 0;
    row.rate.fill.style.width = `${100 * rate / this.top}%`;
    row.rate.text.textContent = drives ? number(rate, 2) : there ? "arrived" : "-";
    row.power.fill.style.width = `${100 * power / this.scene.power_w}%`;
    row.power.text.textContent = drives ? number(1000 * power, power < .01 ? 2 : 0) : "";
    const place = order[slot].indexOf(robot) + 1;
    row.decoded.textContent = drives && !this.scene.oma ? ordinal(place) : "-";
    row.gain.textContent = drives ? `${number(gains_db[slot][robot], 0)} dB` : "";
  }

  showRis(slot) {
    const { beams, phases_deg } = this.episode;
    const values = beams ? [beams[slot]] : phases_deg[slot];
    this.tiles.replaceChildren(...values.map((value) => {
      const tile = element("span", { class: "tile" }, beams ? String(value) : `${value}°`);
      tile.style.background = beams ? "#e9edf1" : `hsl(${value} 65% 72%)`;
      return tile;
    }));
  }

  // The slot in words, for those who do not see it.
  words(time) {
    const slot = Math.min(Math.floor(time), this.slots - 1), { driving, rates, cells } = this.episode;
    const each = this.scene.destinations.map((goal, robot) => driving[slot][robot]
      ? `robot ${robot} at ${number(rates[slot][robot], 1)} bit/s/Hz`
      : cells[slot][robot] === goal ? `robot ${robot} has arrived` : `robot ${robot} stopped`);
    return `Slot ${slot + 1} of ${this.slots}: ${each.join(", ")}.`;
  }
}

function ordinal(place) {
  const ends = { 1: "st", 2: "nd", 3: "rd" };
  const teens = place % 100 >= 11 && place % 100 <= 13;
  return `${place}${teens ? "th" : ends[place % 10] || "th"}`;
}
