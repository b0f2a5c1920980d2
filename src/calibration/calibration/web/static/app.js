// The page: who is here, what is going on, the three parts, and the stop that is always there.
import { h, text, flag, hide, once, rows } from "./dom.js";
import { w, speak, language, known, number } from "./words.js";
import { ask, connect, device, enter, leave, me } from "./link.js";
import { before } from "./before.js";
import { during } from "./during.js";
import { after } from "./after.js";
import { sound } from "./sound.js";
import { edges } from "./edges.js";
import { sure } from "./sure.js";

const state = { silent: true, lost: false, hold: 0, me: {}, events: [] };
const top = document.getElementById("top");
const main = document.getElementById("main");
const foot = document.getElementById("foot");
let parts = null;
let shown = "";
let chosen = false;
let begun = false;  // a run was begun here, and no state shows it yet: the last one may still show the run before
state.follow = () => { chosen = false; begun = true; show("during"); };
state.open = (name) => { chosen = true; show(name); };

async function start() {
  edges(top, foot);
  await speak(localStorage.getItem("language") || navigator.language.slice(0, 2));
  const secret = location.hash.slice(1);
  if (secret) history.replaceState(null, "", "/");
  const who = await me();
  if (who) page();
  else entry(secret);
}

function entry(secret, said = "") {
  top.replaceChildren(h("h1", {}, w("title")));
  foot.replaceChildren(h("div", { id: "no_stop", class: "lost" }, w("no_stop")));
  const name = h("input", { id: "name", autocomplete: "name", maxLength: 80, required: true });
  const code = h("input", { id: "token", autocomplete: "off", value: secret, required: true });
  name.value = localStorage.getItem("name") || "";
  code.value = secret;
  const answer = h("p", { role: "alert", class: "small" }, said);
  const go = async (event) => {
    event.preventDefault();
    const found = await enter(code.value.trim(), name.value.trim());
    if (found.status === 200) {
      localStorage.setItem("name", name.value.trim());
      page();
    } else text(answer, found.text || w("no_answer"));
  };
  main.replaceChildren(
    h("form", { class: "card", onsubmit: go },
      h("h2", {}, w("enter_title")),
      h("label", { for: "name" }, w("your_name")), name,
      h("label", { for: "token" }, w("token")), code,
      h("p", { class: "small" }, w("token_where")),
      h("button", { class: "main", id: "enter" }, w("enter")), answer));
  window.onhashchange = () => { code.value = location.hash.slice(1); };
  (secret ? name : code).focus();
}

function page() {
  const doing = h("div", { class: "now", id: "now" });
  const waiting = h("div", { id: "waiting" });
  const lost = h("div", { class: "lost", id: "lost", role: "alert", hidden: true });
  const faults = h("section", { id: "faults", "aria-live": "polite", "aria-label": w("faults") });
  const left = h("div", { class: "lost", id: "load_left", role: "alert", hidden: true });
  const control = h("button", { id: "control", onclick: once(async () => {
    if (state.me.control) return told(await ask("control_release"));
    const answer = await ask("control_ask");
    return told(answer.text && answer.status === 200 ? { done: true, text: answer.text } : answer); // somebody is asked, which is done
  }) });
  const tabs = ["before", "during", "after"].map((name) =>
    h("button", { id: `tab_${name}`, onclick: () => state.open(name) }, w(name)));
  const tongue = h("button", { onclick: async () => { localStorage.setItem("language", language === "en" ? "de" : "en"); location.reload(); } }, language === "en" ? "Deutsch" : "English");
  const loud = h("button", { id: "sound", "aria-pressed": String(sound.on), onclick: () => { loud.setAttribute("aria-pressed", String(sound.toggle())); } }, w("sound"));
  const more = h("button", { id: "device", onclick: () => addDevice() }, w("device"));
  const other = h("button", { id: "operator", onclick: async () => {
    const name = await sure("operator_who", true, 1);
    if (name) told(await ask("operator", { name }));
  } }, w("operator"));
  const away = h("button", { id: "leave", onclick: async () => {
    if (!(await sure("leave_sure"))) return;
    const answer = await leave();
    if (answer.done) location.reload();
    else told(answer);
  } }, w("leave"));
  const menu = h("div", { class: "row", id: "menu", hidden: true }, loud, more, other, away, tongue);
  const menu_button = h("button", { id: "menu_button", "aria-expanded": "false", onclick: () => {
    hide(menu, !menu.hidden);
    menu_button.setAttribute("aria-expanded", String(!menu.hidden));
  }, "aria-label": w("menu") }, "☰");
  const ahead = h("div", { class: "card", id: "unfinished", hidden: true });
  const toast = h("div", { id: "toast", class: "toast", role: "status", hidden: true });
  const handover = h("div", { id: "handover", class: "card", hidden: true });
  top.replaceChildren(
    h("div", { class: "row" }, h("h1", { id: "cell", class: "grow" }), h("nav", { class: "row", "aria-label": w("parts") }, ...tabs),
      control, menu_button),
    menu, lost, left, h("div", { class: "live", "aria-live": "polite" }, doing, waiting), handover);
  foot.replaceChildren(toast, h("button", { id: "stop", onclick: stop }, w("stop"), h("span", {}, w("stop_is_none"))));
  parts = { before: before(state, told), during: during(state, told), after: after(state, told) };
  main.replaceChildren(faults, ahead, ...Object.values(parts).map((one) => one.node));
  show("before");

  let last = "";
  let asking = false;
  const old = () => { // nothing that is shown is current: the connection is cut, or the manager is silent
    flag(document.body, "stale", state.lost || state.silent);
    hide(lost, !(state.lost || state.silent));
    text(lost, state.lost ? w("lost") : state.silent ? w("nothing_known") : "");
  };
  connect(
    (news) => {
      Object.assign(state, news);
      const view = state.view;
      old();
      const dumb = state.silent || !view;
      text(document.getElementById("cell"), `${state.cell.name} · ${state.me.name}`);
      text(doing, dumb ? "" : activity(view));
      text(waiting, !dumb && view.waiting ? `${w("waits_for")}: ${waited(view)}` : "");
      if (asking && !state.me.asking) told(state.me.control ? { done: true } : { done: false, text: w("control_kept") });
      asking = state.me.asking;
      text(control, state.me.control ? w("control_release") : state.me.holder ? w("control_of", { name: state.me.holder }) : w("control_take"));
      flag(control, "main", !state.me.holder);
      rows(handover, state.me.control && state.me.asked_by ? [state.me.asked_by] : [], (name) =>
        h("div", { class: "row" }, h("b", { class: "grow" }, w("asks_control", { name })),
          h("button", { id: "give", class: "main", onclick: () => ask("control_answer", { give: true }) }, w("give")),
          h("button", { onclick: () => ask("control_answer", { give: false }) }, w("keep"))));
      hide(handover, !(state.me.control && state.me.asked_by));
      if (!view) {
        parts.after.update();  // what was measured can be evaluated, whoever is silent now
        return;
      }
      rows(faults, view.faults.map((one) => ({ ...one, mine: Boolean(state.me.control), given: (state.overrides || []).includes(one.source) })), fault);
      hide(left, !view.load.left);
      text(left, view.load.left ? loadLeft(view.load) : "");
      const going = !view.running && !state.silent ? state.unfinished : null;
      hide(ahead, !going);
      rows(ahead, going ? [{ ...going, mine: Boolean(state.me.control) && view.known }] : [], (one) => h("div", { class: "row" },
        h("b", { class: "grow" }, w("unfinished", { name: one.session })),
        h("button", { id: "go_on", class: "main", disabled: !one.mine, onclick: once(async () => {
          const answer = told(await ask("run", { plan: one.plan, session: one.session, resume: true }));
          if (answer.done) state.follow();
        }) }, w("go_on", { name: one.session }))));
      if (view.running) begun = false;
      if (!chosen && !begun && view.known) show(view.running ? "during" : view.procedure.state === "finished" ? "after" : "before");
      for (const one of Object.values(parts)) if (!one.node.hidden) one.update();
      const cue = `${view.load.awaited} ${view.permission.permitted}`;
      if (cue !== last && last) sound.play(view.load.awaited || !view.permission.permitted);
      last = cue;
    },
    (late) => {
      if (state.lost === late) return;
      state.lost = late;
      old();
      if (state.view) parts.before.update();
    },
    () => entry("", w("session_over")));
}

function show(name) {
  if (shown === name) return;
  shown = name;
  window.scrollTo(0, 0);
  for (const [key, one] of Object.entries(parts)) {
    hide(one.node, key !== name);
    const tab = document.getElementById(`tab_${key}`);
    if (key === name) tab.setAttribute("aria-current", "page");
    else tab.removeAttribute("aria-current");
  }
  if (parts[name].opened) parts[name].opened();
  if (state.view) parts[name].update();
}

function activity(view) {
  if (!view.known) return w("sequencer_silent");
  const procedure = view.procedure;
  const paused = procedure.paused && procedure.state !== "ready" ? ` · ${w("paused_after")}` : "";
  if (["startup", "reference"].includes(procedure.kind) && known(`phase_${procedure.state}`)) return `${w(procedure.kind)}: ${w(`phase_${procedure.state}`)}${paused}`;
  const place = { configuration: procedure.configuration, step: procedure.step + 1, steps: procedure.steps };
  const key = `state_${procedure.paused && procedure.state === "ready" ? "paused" : procedure.state}`;
  return `${known(key) ? w(key, place) : view.text}${paused}`;
}
function loadLeft(load) {
  return `${load.felt === null ? w("load_left_unknown") : w("load_left", { n: number(load.felt) })} ${load.left}`;
}
function waited(view) {
  const who = w(`party_${view.procedure.waits_for}`);
  if (language === "en" || !view.known) return view.waiting;
  return view.load.awaited ? who : `${who} (${view.waiting})`;  // what to pull stands in the card of the load
}

function fault(one) {
  const key = `fault_${one.code}`;
  const remedy = known(`remedy_${one.code}`) ? w(`remedy_${one.code}`, { name: one.source, remedy: one.remedy }) : one.remedy;
  return h("div", { class: `fault ${one.level}`, "data-code": one.code },
    h("b", {}, known(key) ? w(key, { source: known(`node_${one.source}`) ? w(`node_${one.source}`) : one.source }) : one.text),
    h("span", { class: "small" }, one.text), ...(remedy ? [h("br"), h("span", {}, `→ ${remedy}`)] : []),
    ...(one.code === "condition" ? [h("button", { "data-override": one.source, disabled: !one.mine || one.given, onclick: () => overridden(one.source) },
      w(one.given ? "condition_given" : "condition_override"))] : []));
}
async function overridden(condition) {
  const reason = await sure("condition_why", true);
  if (reason) told(await ask("override_condition", { condition, reason }));
}

async function stop() {
  const began = performance.now();
  const answer = await ask("stop");
  told(answer.done ? { done: true, text: w("stop_sent", { ms: Math.round(performance.now() - began) }) }
    : { done: false, text: answer.heard ? w("stop_nothing", { text: answer.text }) : `${w("stop_unheard")} ${answer.text}` });
}

let fading = 0;
function told(answer) {
  const toast = document.getElementById("toast");
  const words = answer.text || (answer.done ? w("done") : w("no_answer"));
  text(toast, answer.done ? words : `${w("not_done")}: ${words}`);
  hide(toast, false);
  clearTimeout(fading);
  fading = setTimeout(() => hide(toast, true), answer.done ? 3000 : 8000);
  return answer;
}

async function addDevice() {
  const found = await device();
  const box = h("div", { id: "qr", class: "card" }, h("h2", {}, w("device_how")), h("img", { src: found.image, alt: found.url, width: 300 }),
    h("p", { class: "small" }, found.url), h("button", { onclick: () => box.remove() }, w("close")));
  document.getElementById("qr")?.remove();
  main.prepend(box);
}

start();
