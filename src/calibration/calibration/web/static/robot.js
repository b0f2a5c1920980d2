// The robot in space: as it stands, and, while a motion is under way, where it goes and along which path.
import { h, text, flag, hide } from "./dom.js";
import { w } from "./words.js";
import "./scene.js";

const STEPS = 24; // points of a path
const PERIOD = 100; // ms between two drawings
const PULL = { length: 1, width: 0.02, colour: [0, 0.19, 0.43] }; // m; share of the scene; as the arrow beside it

// A point of the flange frame in the base frame; `m` is a 4 x 4 matrix, column by column.
const placed = (m, p) => [0, 1, 2].map((i) => m[i] * p[0] + m[4 + i] * p[1] + m[8 + i] * p[2] + m[12 + i]);

export function robot(state) {
  const place = h("div", { id: "scene" });
  const going = h("p", { id: "going" });
  const node = h("section", { class: "card", id: "robot", "aria-label": w("robot") }, h("h2", {}, w("robot")), place, going);
  let drawing = null;
  let scene = null;
  let goal = "";
  let last = "";
  let pull = "[]";
  let drawn = 0;

  async function opened() {
    if (drawing) return;
    const answer = await fetch("/api/scene", { cache: "no-store" });
    scene = answer.ok ? await answer.json() : null;
    const words = Object.fromEntries(["robot", "targets", "frames", "tracker", "boxes", "force", "names", "reset", "hint"].map((key) => [key, w(`scene_${key}`)]));
    drawing = scene ? window.calibrationScene(place, scene.view, { words, fixed: true, shown: { frames: false, tracker: false } }) : null;
    hide(place, !drawing);
    if (!drawing) text(going, w("no_drawing"));
  }
  // The way of the flange in a motion that takes the joints there together.
  function path(from, to) {
    const points = [];
    for (let step = 0; step <= STEPS; step += 1) {
      const share = step / STEPS;
      drawing.posture(from.map((value, i) => value + share * (to[i] - value)));
      points.push(placed(drawing.flange(), scene.wrench_point));
    }
    return points;
  }
  function update() {
    const now = performance.now();
    flag(place, "old", !state.q);
    if (drawing && !state.q) text(going, w("joints_unknown"));
    if (!drawing || !state.q || now - drawn < PERIOD) return;
    const { view } = state;
    const wanted = JSON.stringify(view.goal);
    if (wanted !== goal) {
      goal = wanted;
      drawing.places(view.goal.length ? { [w("path")]: path(state.q, view.goal) } : {});
      last = "";
    }
    text(going, view.goal.length ? w("going") : w("stands"));
    const what = JSON.stringify(state.q.map((value) => value.toFixed(3)));
    if (what !== last) {
      last = what;
      drawn = now;
      drawing.posture(state.q);
    }
    const { load } = view;  // the arrow alone where it changes: drawing it makes the switches of the view anew
    const pulled = JSON.stringify(load.awaited ? [load.direction, state.q.map((value) => value.toFixed(2))] : []);
    if (pulled === pull) return;
    pull = pulled;
    const vector = load.direction.map((value) => PULL.length * value);
    const start = placed(drawing.flange(), scene.wrench_point);
    drawing.arrows(load.awaited && vector.length ? [{ kind: "force", posture: 0, start, vector, width: PULL.width, colour: PULL.colour }] : []);
  }
  return { node, opened, update };
}
