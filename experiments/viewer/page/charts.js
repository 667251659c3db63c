// Small line charts.

const WIDTH = 320, HEIGHT = 150, LEFT = 44, BOTTOM = 20, TOP = 8, RIGHT = 8;

// Lines are { name, colour, x, y, dots }; nulls leave gaps.
function chart(title, lines, unit, range) {
  const values = lines.flatMap((line) => line.y).filter((y) => y !== null);
  const places = lines.flatMap((line) => line.x);
  if (!values.length) return element("figure", { class: "chart" }, element("figcaption", {}, `${title}: none yet`));
  const [low, high] = range || spread(values);
  const first = Math.min(...places), last = Math.max(...places, first + 1);
  const x = (at) => LEFT + (at - first) / (last - first) * (WIDTH - LEFT - RIGHT);
  const y = (value) => HEIGHT - BOTTOM - (value - low) / (high - low) * (HEIGHT - BOTTOM - TOP);
  const newest = lines.map((line) => `${line.name} ${brief(line.y.at(-1) ?? null)}`).join(", ");
  const svg = shape("svg", {
    viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": `${title}; newest: ${newest}`,
  });
  for (const value of [low, (low + high) / 2, high]) {
    svg.append(
      shape("line", { x1: LEFT, x2: WIDTH - RIGHT, y1: y(value), y2: y(value), stroke: "#e3e7ec" }),
      label(LEFT - 4, y(value) + 4, brief(value), "end"),
    );
  }
  svg.append(label(LEFT, HEIGHT - 5, brief(first), "start"), label(WIDTH - RIGHT, HEIGHT - 5, `${unit} ${brief(last)}`, "end"));
  for (const line of lines) {
    let path = "", gap = true;
    line.y.forEach((value, i) => {
      if (value === null) { gap = true; return; }
      path += `${gap ? "M" : "L"}${x(line.x[i]).toFixed(1)} ${y(Math.min(Math.max(value, low), high)).toFixed(1)}`;
      gap = false;
      if (line.dots) svg.append(shape("circle", { cx: x(line.x[i]), cy: y(value), r: 2.2, fill: line.colour }));
    });
    svg.append(shape("path", {
      d: path, fill: "none", stroke: line.colour, "stroke-width": 1.6,
      "stroke-dasharray": line.dashed ? "5 3" : "none",
    }));
  }
  const names = lines.map((line) => {
    const swatch = element("span", {}, line.dashed ? " ╌ " : " ━ ");
    swatch.style.color = line.colour;
    return element("small", {}, swatch, line.name);
  });
  return element("figure", { class: "chart" }, element("figcaption", {}, title), svg, ...names);
}

function label(x, y, text, anchor) {
  const made = shape("text", { x, y, "text-anchor": anchor });
  made.textContent = text;
  return made;
}

function spread(values) {
  const low = Math.min(...values), high = Math.max(...values), room = (high - low || Math.abs(high) || 1) * .06;
  return [low - room, high + room];
}

function brief(value) {
  if (value === null) return "-";
  const size = Math.abs(value);
  return size >= 100 || Number.isInteger(value) ? value.toFixed(0) : value.toPrecision(size < 1 ? 2 : 3);
}
