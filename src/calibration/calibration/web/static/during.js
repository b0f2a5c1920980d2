// While a plan is measured: where it stands, whether the robot may move, the load to bring on, what has been learnt.
import { h, text, flag, hide, once, rows } from "./dom.js";
import { w, number, duration, language } from "./words.js";
import { ask } from "./link.js";
import { directions } from "./draw.js";
import { robot } from "./robot.js";
import { sure } from "./sure.js";

const CHAIN = ["moving", "loading", "settling", "reading", "unloading"];
const DEGREES = 180 / Math.PI;

export function during(state, told) {
  const make = (tag, id, given = {}) => h(tag, { id, ...given });
  const where = make("div", "where", { class: "number" });
  const left = make("p", "left");
  const done = h("i");
  const chain = h("ol", { class: "chain", id: "chain" });
  const permit = h("section", { class: "card permit wide", id: "permit", "aria-live": "polite" });
  const permitted = h("div", { class: "big" });
  const reason = h("div", {});
  const speed = h("div", { class: "small" });
  const reset = h("button", { id: "reset", onclick: async () => (await sure("reset_sure")) && told(await ask("guard_reset")) }, w("reset"));
  const motion = h("button", { id: "resume_motion", onclick: once(async () => told(await ask("resume_motion"))) }, w("resume_motion"));
  const mode = h("button", { id: "confirm_mode", onclick: async () => (await sure("mode_sure")) && told(await ask("confirm_mode", { valid_for: 3600 })) }, w("confirm_mode"));
  permit.append(h("div", { class: "row" }, permitted, h("div", { class: "grow" }, reason, speed), reset, motion, mode));

  const load = h("section", { class: "card", id: "load", "aria-label": w("load") });
  const pull = make("div", "pull", { class: "number" });
  const axes = make("p", "axes");
  const felt = make("div", "felt");
  const band = h("div", { class: "band" });
  const needle = h("div", { class: "needle" });
  const gauge = h("div", { class: "gauge", role: "img", "aria-label": w("force_gauge") }, band, needle);
  const angle = make("div", "angle");
  const drawing = directions();
  const confirm = h("button", { class: "go", id: "confirm", onclick: once(async () => {
    const release = state.view.load.wanted === 0;
    const answer = await ask("load_applied", place());
    told(answer.done ? { done: true, text: w(release ? "released" : "applied") } : answer);
  }) });
  const against = make("p", "against", { "aria-live": "polite" });
  const override = h("button", { id: "override", onclick: () => overridden() }, w("override_load"));
  load.append(h("h2", {}, w("load")), pull, axes, felt, gauge, angle, confirm, against, drawing.node, override);
  hide(load, true); // until a load is awaited

  const verdict = make("p", "verdict");
  const averaged = h("i");
  const averaging = make("p", "averaging");
  const average = h("div", { class: "bar", id: "average", role: "img", "aria-label": w("averaging_bar") }, averaged);
  const reading = h("section", { class: "card", "aria-label": w("reading") }, h("h2", {}, w("reading")), averaging, average, verdict,
    h("p", { id: "standing" }), h("p", { id: "beam" }));
  const aimed = make("p", "aimed", { "aria-live": "polite" });
  const of_point = [["skip", "point_skip"], ["repeat", "point_repeat"], ["exclude", "point_exclude"]].map(([what, name]) => h("button", { id: name, class: "grow", onclick: once(async () => {
    const { point } = state.view.procedure;
    const reason = what === "exclude" ? await sure("exclude_why", true) : "";
    if (what !== "exclude" || reason) told(await ask("point", { what, point, reason }));
  }) }, w(name)));
  const points = h("div", { id: "points" }, aimed, h("div", { class: "row", role: "group", "aria-label": w("of_point") }, ...of_point));
  reading.append(points);
  const bars = h("div", { id: "bars" });
  const learnt = h("p", { id: "learnt" });
  const accuracy = h("section", { class: "card", "aria-label": w("accuracy") }, h("h2", {}, w("accuracy")), bars, learnt);
  const buttons = ["pause", "resume", "repeat", "skip"].map((name) =>
    h("button", { id: name, class: "grow", onclick: once(async () => (name !== "skip" || (await sure("skip_sure"))) && told(await ask(name))) }, w(name)));
  const space = robot(state);
  const question = make("p", "question", { class: "number" });
  const why = make("p", "lost_at");
  const events = h("ol", { class: "plain", id: "events" });
  const node = h("div", { class: "grid", id: "during" }, permit, load, space.node,
    h("div", { class: "column" },
      h("section", { class: "card", "aria-label": w("progress") }, h("h2", {}, w("progress")), where,
        h("div", { class: "bar", role: "img", "aria-label": w("progress") }, done), left, chain, question, why, h("div", { class: "row", role: "group", "aria-label": w("steer") }, ...buttons)),
      reading, accuracy,
      h("section", { class: "card", "aria-label": w("events") }, h("h2", {}, w("events")), events)));

  function place() {
    return { configuration: state.view.procedure.configuration, step: state.view.procedure.step };
  }
  async function overridden() {
    const at = place();
    const reason = await sure("override_why", true);
    if (reason) told(await ask("load_applied", { ...at, override: true, reason }));
  }

  function update() {
    const { view } = state;
    const p = view.procedure;
    const mine = Boolean(state.me.control);
    text(where, p.kind === "startup" ? w("startup") : p.kind === "reference" ? w("reference")
      : p.total ? w("configuration_of", { n: p.configuration, done: p.done, total: p.total }) : "");
    const remaining = view.running ? [`${w("time_left")}: ${duration(p.seconds_left)}`] : [];
    text(left, [...remaining, ...(p.skipped ? [w("skipped", { n: p.skipped })] : [])].join(" · "));
    done.style.width = `${Math.round(100 * (p.share_done || 0))}%`;
    rows(chain, CHAIN.map((name) => [name, p.state === name]), ([name, on]) => {
      const one = h("li", {}, w(`phase_${name}`));
      if (on) { one.className = "on"; one.setAttribute("aria-current", "step"); }
      return one;
    });
    for (const one of node.querySelectorAll("section")) flag(one, "old", !view.known && one !== permit && one !== space.node);
    text(why, p.held && state.lost_at ? w("lost_at", { time: clock(state.lost_at.time), text: state.lost_at.text }) : "");
    rows(events, [...(state.events || [])].reverse(), (one) => h("li", {}, h("span", {}, `${clock(one.time)} · ${one.source}: ${one.text}`)));
    text(question, p.waits_for === "operator" && !p.load_awaited && p.question ? p.question : "");

    const permission = view.permission;
    flag(permit, "yes", permission.permitted);
    flag(permit, "unknown", !permission.known);
    text(permitted, w(!permission.known ? "permission_unknown" : !permission.permitted ? "not_permitted" : p.moving ? "robot_moves" : "permitted"));
    text(reason, permission.permitted ? (p.waits_for === "operator" && !p.moving ? w("waits_for_you") : "") : permission.reasons.map((one) => w(`reason_${one}`)).join(" · "));
    text(speed, permission.known && permission.speed !== null
      ? w("speed", { speed: number(1000 * permission.speed), limit: number(1000 * permission.speed_limit), point: permission.speed_point }) : "");
    hide(reset, !permission.latched);
    hide(motion, !p.held);
    hide(mode, !permission.reasons.some((one) => one === "mode_unknown" || one === "confirmation_expired"));
    for (const one of [reset, motion, mode, ...buttons, override]) one.disabled = !mine;
    for (const one of buttons.slice(0, 2)) one.disabled = !mine || !view.known;
    hide(buttons[0], p.paused || !view.running);
    hide(buttons[1], !p.paused || p.held);
    for (const one of buttons.slice(2)) one.disabled = !mine || !view.running || p.kind !== "configuration";

    const l = view.load;
    hide(load, !l.awaited);
    flag(node, "two", !l.awaited);
    if (l.awaited) loads(view, l, mine);
    hide(points, !p.point && !p.points_excluded.length);
    text(aimed, [...(p.point ? [w("point_now", { point: p.point })] : []),
      ...(p.points_left.length ? [w("points_left", { points: p.points_left.join(", ") })] : []),
      ...(p.points_excluded.length ? [w("points_excluded", { points: p.points_excluded.join(", ") })] : [])].join(" · "));
    for (const one of of_point) one.disabled = !mine || !p.point;
    const share = p.averaged === null ? null : Math.round(100 * p.averaged);
    text(averaging, share === null ? w("averaging_none") : w("averaging", { share }));
    averaged.style.width = `${share || 0}%`;
    text(verdict, view.reading.verdict === "none" ? w("verdict_none") : w(`verdict_${view.reading.verdict}`,
      { place: view.reading.configuration ? w("place", { configuration: view.reading.configuration, step: view.reading.step + 1 }) : w("reference"), text: view.reading.text }));
    text(document.getElementById("standing"), permission.standing === null ? w("standing_unknown") : w(permission.standing ? "standing" : "moving_now"));
    const broken = view.streams.filter((one) => one.problem !== "fine");
    text(document.getElementById("beam"), broken.length ? broken.map((one) => `${one.name}: ${w(`stream_${one.problem}`)}`).join(" · ") : w("streams_fine"));
    rows(bars, view.bars, (one) => {
      const inside = h("i", { class: one.share >= 1 ? "done" : "" });
      inside.style.width = `${Math.round(100 * (one.share || 0))}%`;
      const words = one.accuracy === null ? w("accuracy_none") : w("accuracy_now", { now: number(100 * one.accuracy, 1), expected: number(one.expected === null ? null : 100 * one.expected, 1) });
      return h("div", {}, h("div", { class: "small" }, `${one.joint}: ${words}`), h("div", { class: "bar", role: "img", "aria-label": `${one.joint}: ${words}` }, inside));
    });
    const next = view.progress.next_configuration;
    text(learnt, view.bars.length ? `${view.progress.text}${next ? ` · ${w("next_configuration", { n: next })}` : ""}` : w("accuracy_later"));
  }

  function loads(view, l, mine) {
    const release = l.wanted === 0;
    text(pull, release ? w("release") : w("pull_with", { n: number(l.wanted) }));
    text(axes, release ? "" : w("pull_axes", { x: number(l.force[0]), y: number(l.force[1]), z: number(l.force[2]) }));
    drawing.show(l.direction, l.along, l);
    text(felt, l.felt === null ? w("felt_unknown") : w("felt", { n: number(l.felt), off: number(l.off_force), band: number(l.band_force) }));
    const span = Math.max(1.6 * l.wanted, 4 * (l.band_force || 0), 50);
    const checked = view.known && l.band_force !== null;
    hide(band, !checked);
    band.style.left = `${(100 * Math.max(l.wanted - (l.band_force || 0), 0)) / span}%`;
    band.style.width = `${(100 * (Math.min(l.wanted, l.band_force || 0) + (l.band_force || 0))) / span}%`;
    hide(needle, l.felt === null);
    needle.style.left = `${Math.min(100, (100 * (l.felt || 0)) / span)}%`;
    text(angle, release || l.off_angle === null ? "" : w("angle", { off: number(DEGREES * l.off_angle, 1), band: number(l.band_angle === null ? null : DEGREES * l.band_angle, 1) }));
    const by_device = view.procedure.waits_for === "load_device";
    hide(confirm, by_device);
    hide(override, by_device || view.confirm.offered);
    confirm.disabled = !mine || !view.confirm.offered;
    const held = state.hold && view.confirm.by_itself ? ` (${w("confirms_itself", { s: number(Math.max(0, state.hold - (state.held || 0)), 1) })})` : "";
    text(confirm, `${w(release ? "confirm_release" : "confirm")}${held}`);
    const why = [...(mine ? [] : ["no_control"]), ...view.confirm.against].map((one) => (one.startsWith("stream_") ? w("against_stream", { problem: w(one) }) : w(`against_${one}`)));
    const differs = view.confirm.text && view.confirm.against.some((one) => one === "load_differs" || one === "load_not_felt");
    text(against, by_device ? w("device_loads") : [...why, ...(differs ? [view.confirm.text] : [])].join(" · "));
  }
  const clock = (seconds) => new Date(1000 * seconds).toLocaleTimeString(language);
  return { node, update: () => { update(); space.update(); }, opened: space.opened };
}
