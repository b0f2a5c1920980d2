// The page: who is here, what is going on, the three parts, and the stop that is always there.
import { h, text, flag, hide, rows } from "./dom.js";
import { w, speak, language, known } from "./words.js";
import { ask, connect, device, enter, me } from "./link.js";
import { before } from "./before.js";
import { during } from "./during.js";
import { after } from "./after.js";
import { sound } from "./sound.js";
import { edges } from "./edges.js";

const state = { silent: true, hold: 0, me: {} };
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
  foot.replaceChildren();
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
  (secret ? name : code).focus();
}

function page() {
  const doing = h("div", { class: "now", id: "now" });
  const waiting = h("div", { id: "waiting" });
  const lost = h("div", { class: "lost", id: "lost", role: "alert", hidden: true });
  const faults = h("section", { id: "faults", "aria-live": "polite", "aria-label": w("faults") });
  const control = h("button", { id: "control", onclick: () => ask(state.me.control ? "control_release" : "control_ask").then(told) });
  const tabs = ["before", "during", "after"].map((name) =>
    h("button", { id: `tab_${name}`, onclick: () => state.open(name) }, w(name)));
  const tongue = h("button", { onclick: async () => { localStorage.setItem("language", language === "en" ? "de" : "en"); location.reload(); } }, language === "en" ? "Deutsch" : "English");
  const loud = h("button", { id: "sound", "aria-pressed": String(sound.on), onclick: () => { loud.setAttribute("aria-pressed", String(sound.toggle())); } }, w("sound"));
  const more = h("button", { id: "device", onclick: () => addDevice() }, w("device"));
  const toast = h("div", { id: "toast", class: "toast", role: "status", hidden: true });
  const handover = h("div", { id: "handover", class: "card", hidden: true });
  top.replaceChildren(
    h("div", { class: "row" }, h("h1", { id: "cell", class: "grow" }), h("nav", { class: "row", "aria-label": w("parts") }, ...tabs),
      control, loud, more, tongue),
    lost, h("div", { class: "live" }, doing, waiting), handover);
  foot.replaceChildren(toast, h("button", { id: "stop", onclick: stop }, w("stop"), h("span", {}, w("stop_is_none"))));
  parts = { before: before(state, told), during: during(state, told), after: after(state, told) };
  main.replaceChildren(faults, ...Object.values(parts).map((one) => one.node));
  show("before");

  let last = "";
  connect(
    (news) => {
      Object.assign(state, news);
      const view = state.view;
      const dumb = state.silent || !view;
      text(document.getElementById("cell"), `${state.cell.name} · ${state.me.name}`);
      text(doing, dumb ? w("nothing_known") : activity(view));
      text(waiting, !dumb && view.waiting ? `${w("waits_for")}: ${waited(view)}` : "");
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
      rows(faults, view.faults, fault);
      if (view.running) begun = false;
      if (!chosen && !begun) show(view.running ? "during" : view.procedure.state === "finished" ? "after" : "before");
      for (const one of Object.values(parts)) if (!one.node.hidden) one.update();
      const cue = `${view.load.awaited} ${view.permission.permitted}`;
      if (cue !== last && last) sound.play(view.load.awaited || !view.permission.permitted);
      last = cue;
    },
    (late) => {
      flag(document.body, "stale", late);
      hide(lost, !late);
      text(lost, late ? w("lost") : "");
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
  if (["startup", "reference"].includes(procedure.kind) && known(`phase_${procedure.state}`)) return `${w(procedure.kind)}: ${w(`phase_${procedure.state}`)}`;
  const place = { configuration: procedure.configuration, step: procedure.step + 1, steps: procedure.steps };
  const key = `state_${procedure.paused && procedure.state === "ready" ? "paused" : procedure.state}`;
  return known(key) ? w(key, place) : view.text;
}
function waited(view) {
  const who = w(`party_${view.procedure.waits_for}`);
  if (language === "en" || !view.known) return view.waiting;
  return view.load.awaited ? who : `${who} (${view.waiting})`;  // what to pull stands in the card of the load
}

function fault(one) {
  const key = `fault_${one.code}`;
  return h("div", { class: `fault ${one.level}`, "data-code": one.code },
    h("b", {}, known(key) ? w(key, { source: known(`node_${one.source}`) ? w(`node_${one.source}`) : one.source }) : one.text),
    h("span", { class: "small" }, one.text), ...(one.remedy ? [h("br"), h("span", {}, `→ ${one.remedy}`)] : []));
}

async function stop() {
  const began = performance.now();
  const answer = await ask("stop");
  told(answer.done ? { done: true, text: w("stop_sent", { ms: Math.round(performance.now() - began) }) }
    : { done: false, text: `${w("stop_unheard")} ${answer.text}` });
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
