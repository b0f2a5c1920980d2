// Before a run: is everything in order, which plan, which session, and the instruments' own tests.
import { h, text, rows, options, hide } from "./dom.js";
import { w, known } from "./words.js";
import { ask, folder } from "./link.js";

const HOLDS = [0, 1, 2, 3, 5];
const NEW = "";

export function before(state, told) {
  const list = h("ul", { class: "plain", id: "checklist" });
  const summary = h("p", { id: "checked", class: "number" });
  const plan = h("select", { id: "plan" });
  const session = h("select", { id: "session" });
  const name = h("input", { id: "session_name", maxLength: 60, autocomplete: "off" });
  const named = h("div", {}, h("label", { for: "session_name" }, w("session_name")), name);
  const wanted = h("input", { id: "wanted", inputMode: "decimal", autocomplete: "off", size: 6 });
  const enough = h("input", { id: "enough", type: "checkbox" });
  const hold = h("select", { id: "hold" }, ...HOLDS.map((one) => h("option", { value: String(one) }, one ? w("hold_for", { s: one }) : w("hold_off"))));
  hold.addEventListener("change", () => ask("hold_time", { seconds: Number(hold.value) }).then(told));
  const begin = h("button", { class: "go", id: "begin", onclick: () => run() }, w("begin"));
  const why = h("p", { id: "begin_why", "aria-live": "polite" });
  const frame = h("iframe", { title: w("plan_report"), sandbox: "allow-scripts", hidden: true });
  const look = h("button", { id: "plan_look", onclick: () => {
    frame.src = `/files/${plan.value.replace(/[^/]+$/, "report.html")}`;
    hide(frame, false);
  } }, w("plan_look"));

  const mass = h("input", { id: "mass", inputMode: "decimal", size: 6, autocomplete: "off" });
  const held = h("p", { id: "self_test", "aria-live": "polite" }, w("self_test_1"));
  const tests = ["clear", "add", "evaluate"].map((step) => h("button", { id: `test_${step}`, onclick: async () => {
    const answer = told(await ask("self_test", { step, mass: Number(mass.value.replace(",", ".")) || 0 }));
    text(held, answer.done ? w(`self_test_${step}`) : answer.text);
  } }, w(`test_${step}`)));
  const tare = h("button", { id: "tare", onclick: () => ask("tare").then(told) }, w("tare"));

  const card = (name, ...content) => h("section", { class: "card", "aria-label": w(name) }, h("h2", {}, w(name)), ...content);
  const node = h("div", { class: "grid", id: "before" },
    card("checklist", summary, list),
    h("div", { class: "column" },
      card("measurement", h("label", { for: "plan" }, w("plan")), plan, look, h("label", { for: "session" }, w("session")), session, named, begin, why),
      card("options", h("label", { for: "wanted" }, w("wanted")), wanted,
        h("div", { class: "check" }, enough, h("label", { for: "enough" }, w("stop_when_enough"))),
        h("label", { for: "hold" }, w("hold")), hold, h("p", { class: "small" }, w("hold_how")))),
    card("instruments", h("p", {}, w("tare_how")), tare, h("hr"), held, h("label", { for: "mass" }, w("mass")), mass, h("div", { class: "row" }, ...tests)),
    h("section", { class: "wide" }, frame));

  let asked = false;
  async function run() {
    asked = true;
    begin.disabled = true;
    const resume = session.value !== NEW;
    const aim = Number(wanted.value.replace(",", ".")) / 100 || 0;
    const answer = told(await ask("run", { plan: plan.value, session: resume ? session.value : name.value.trim(), resume, wanted_accuracy: aim, stop_when_enough: enough.checked }));
    asked = false;
    if (answer.done) {
      typed = typed && resume; // the name is used now
      state.follow();
    } else update();
  }
  async function opened() {
    const found = await folder();
    options(plan, found.plans.map((one) => [one, one]), true);
    if (found.plans.includes(state.proposed)) plan.value = state.proposed;
    state.proposed = "";
    options(session, [[NEW, w("session_new")], ...found.sessions.map((one) => [one.name, w("session_resume", { name: one.name })])], true);
    there = found.sessions.map((one) => one.name);
    propose();
    update();
  }
  session.addEventListener("change", update);
  plan.addEventListener("change", update);
  let there = null; // sessions; null: not known yet
  let typed = false; // the name is the operator's, and stays
  name.addEventListener("input", () => { typed = true; });
  function propose() {
    if (typed || !there || !state.cell) return;
    const wish = state.cell.session;
    let n = 1;
    const one = () => (n === 1 ? wish : `${wish}-${n}`);
    while (there.includes(one())) n += 1;
    if (name.value !== one()) name.value = one();
  }
  function update() {
    propose();
    if (!state.view) return;
    const rowsNow = state.check || [];
    rows(list, rowsNow, (one) => {
      const verdict = one.met === null ? "unknown" : one.met ? "yes" : "no";
      const [kind, ...rest] = one.name.split("_");
      const key = known(`check_${one.name}`) ? `check_${one.name}` : `check_${kind}`;
      const seen = one.code && known(`${one.code}_${one.seen}`) ? w(`${one.code}_${one.seen}`) : one.seen;
      const help = verdict === "yes" ? "" : known(`help_${one.name}`) ? w(`help_${one.name}`) : known(`help_${kind}_${verdict}`) ? w(`help_${kind}_${verdict}`) : known(`help_${kind}`) ? w(`help_${kind}`) : "";
      return h("li", { class: verdict, "data-name": one.name },
        h("span", { class: "mark", "aria-label": w(`check_is_${verdict}`), role: "img" }, { yes: "✓", no: "✗", unknown: "?" }[verdict]),
        h("span", {}, h("b", {}, w(key, { name: rest.join("_") })), h("span", {}, seen ? `: ${seen}` : ""), help ? h("span", { class: "small" }, h("br"), `→ ${help}`) : null));
    });
    const open = rowsNow.filter((one) => one.met === false).length;
    const current = state.view.known && !state.silent && !state.lost;
    text(summary, !current ? w("check_unknown") : open ? w("check_open", { n: open }) : w("check_fine"));
    hide(named, session.value !== NEW);
    const mine = Boolean(state.me.control);
    const against = !current ? "begin_unknown" : !mine ? "begin_control" : state.view.running ? "begin_running" : !plan.value ? "begin_plan" : "";
    begin.disabled = asked || against !== "";
    text(why, against ? w(against) : "");
    for (const one of [tare, hold, ...tests]) one.disabled = !mine;
    if (document.activeElement !== hold) hold.value = String(state.hold || 0);
    look.disabled = !plan.value.includes("/");
  }
  return { node, update, opened };
}
