// Elements from plain values: text is always text, never markup.
export function h(tag, given = {}, ...children) {
  const node = document.createElement(tag);
  for (const [key, value] of Object.entries(given)) {
    if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else if (key in node && typeof value !== "string") node[key] = value;
    else node.setAttribute(key, value);
  }
  node.append(...children.filter((one) => one !== null && one !== undefined));
  return node;
}

// What a press does, once: a second press while it is under way, or within a second, is the same press (gloves).
const AGAIN = 1000; // ms
export function once(work) {
  let until = 0;
  return async (...all) => {
    if (performance.now() < until) return;
    until = Infinity;
    const began = performance.now();
    try {
      await work(...all);
    } finally {
      until = began + AGAIN;
    }
  };
}

const SVG = "http://www.w3.org/2000/svg";
export function s(tag, given = {}, ...children) {
  const node = document.createElementNS(SVG, tag);
  for (const [key, value] of Object.entries(given)) node.setAttribute(key, value);
  node.append(...children);
  return node;
}

// Changes a node only where something is new: what has the focus keeps it, and a screen reader is not disturbed.
export function text(node, value) {
  if (node.textContent !== value) node.textContent = value;
}
export function flag(node, name, on) {
  if (node.classList.contains(name) !== on) node.classList.toggle(name, on);
}
export function hide(node, hidden) {
  if (node.hidden !== hidden) node.hidden = hidden;
}
const kept = new WeakMap();
export function rows(node, items, build) {
  const now = JSON.stringify(items);
  if (kept.get(node) === now) return;
  kept.set(node, now);
  node.replaceChildren(...items.map(build));
}
export function options(select, items, keep) {
  const value = select.value;
  rows(select, items, ([key, label]) => h("option", { value: key }, label));
  if (keep && items.some(([key]) => key === value)) select.value = value;
}
