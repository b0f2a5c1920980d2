// The direction to pull, and what pulls, in a drawing of the base axes: seen from the front left, x to the reader.
import { s, text } from "./dom.js";

const CENTRE = [170, 175];
const SIZE = 130;
const ALONG = { x: [-0.62, 0.45], y: [0.82, 0.28], z: [0, -1] };

function at(vector, length = SIZE) {
  const [x, y, z] = vector;
  return [
    CENTRE[0] + length * (x * ALONG.x[0] + y * ALONG.y[0] + z * ALONG.z[0]),
    CENTRE[1] + length * (x * ALONG.x[1] + y * ALONG.y[1] + z * ALONG.z[1]),
  ];
}
function arrow(colour, width, dashed) {
  const shaft = s("line", { stroke: colour, "stroke-width": width, "stroke-linecap": "round", ...(dashed ? { "stroke-dasharray": "10 8" } : {}) });
  const head = s("path", { fill: colour });
  return {
    node: s("g", {}, shaft, head),
    show(vector) {
      const end = at(vector);
      const [dx, dy] = [end[0] - CENTRE[0], end[1] - CENTRE[1]];
      const size = Math.hypot(dx, dy) || 1;
      const [ux, uy] = [dx / size, dy / size];
      const wide = 2.2 * width;
      shaft.setAttribute("x1", CENTRE[0]); shaft.setAttribute("y1", CENTRE[1]);
      shaft.setAttribute("x2", end[0]); shaft.setAttribute("y2", end[1]);
      head.setAttribute("d", `M${end[0] + wide * ux} ${end[1] + wide * uy}L${end[0] - wide * uy} ${end[1] + wide * ux}L${end[0] + wide * uy} ${end[1] - wide * ux}Z`);
    },
  };
}

export function directions() {
  const wanted = arrow("#00306e", 14, false);
  const felt = arrow("#8a0012", 7, true);
  const title = s("title");
  const node = s("svg", { class: "draw", viewBox: "0 0 340 340", role: "img" }, title);
  for (const [name, vector] of [["x", [1, 0, 0]], ["y", [0, 1, 0]], ["z", [0, 0, 1]]]) {
    const [x, y] = at(vector, 150);
    node.append(s("line", { x1: CENTRE[0], y1: CENTRE[1], x2: x, y2: y, stroke: "#4a4a4a", "stroke-width": 2 }));
    const label = s("text", { x: x + 4, y: y + 2 });
    label.textContent = name;
    node.append(label);
  }
  node.append(wanted.node, felt.node);
  return {
    node,
    show(direction, along, load) {
      wanted.node.style.display = direction.length ? "" : "none";
      felt.node.style.display = along.length && load.felt > 0.05 * Math.max(load.wanted, 100) ? "" : "none";
      if (direction.length) wanted.show(direction);
      if (along.length) felt.show(along);
      text(title, `${direction.map((one) => one.toFixed(2)).join(", ")}`);
    },
  };
}
