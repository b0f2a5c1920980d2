// After a run: identification, diagnosis, the report, and what to take along.
import { h, text, once, rows, options, hide } from "./dom.js";
import { w, number } from "./words.js";
import { ask, folder } from "./link.js";

const EVALUATED = ["diagnose/result.json", "identify/result.json"];
const PROPOSED = "diagnose/next.yaml";

export function after(state, told) {
  const session = h("select", { id: "result_session" });
  const how = h("p", { id: "ended", class: "number" });
  const inside = h("i");
  const bar = h("div", { class: "bar", role: "img", "aria-label": w("evaluation") }, inside);
  const doing = h("p", { id: "evaluating", "aria-live": "polite" });
  const buttons = ["stiffness", "diagnosis"].map((what) =>
    h("button", { id: what, class: "main grow", onclick: once(async () => told(await ask("identify", { what, session: session.value }))) }, w(what)));
  const cancel = h("button", { id: "cancel", onclick: () => ask("cancel_evaluation").then(told) }, w("cancel"));
  const shows = h("div", { class: "row", id: "reports" });
  const files = h("div", { class: "row", id: "files" });
  const frame = h("iframe", { id: "report", title: w("report"), sandbox: "allow-scripts", hidden: true });
  const table = h("div", { id: "result" });
  const next = h("button", { id: "next", class: "main", hidden: true, onclick: () => { state.proposed = `${session.value}/${PROPOSED}`; state.open("before"); } }, w("measure_next"));
  const node = h("div", { class: "grid pair", id: "after" },
    h("div", { class: "column" },
      h("section", { class: "card", "aria-label": w("evaluation") }, h("h2", {}, w("evaluation")), how,
        h("label", { for: "result_session" }, w("session")), session,
        h("div", { class: "row" }, ...buttons, cancel), bar, doing)),
    h("section", { class: "card", "aria-label": w("result") }, h("h2", {}, w("result")), table, next),
    h("section", { class: "card wide", "aria-label": w("files") }, h("h2", {}, w("files")), files, shows),
    h("section", { class: "wide" }, frame));
  let found = { plans: [], sessions: [] };
  let finished = "null";

  const path = (file) => `/files/${encodeURIComponent(session.value)}/${file}`;
  async function opened() {
    found = await folder();
    options(session, found.sessions.map((one) => [one.name, one.name]), true);
    await chosen();
  }
  async function content(there) {
    const best = EVALUATED.find((file) => there.includes(file));
    const answer = best ? await fetch(path(best), { cache: "no-store" }) : null;
    return answer && answer.ok ? answer.json() : null;
  }
  async function chosen() {
    const one = found.sessions.find((each) => each.name === session.value);
    const there = one ? one.files : [];
    rows(files, there.map((file) => [session.value, file]), ([, file]) =>
      h("a", { class: "button", href: `${path(file)}?download`, download: "" }, w("download", { file })));
    rows(shows, there.filter((file) => file.endsWith("report.html")).map((file) => [session.value, file]), ([, file]) =>
      h("button", { class: "main", "data-file": file, onclick: () => { frame.src = path(file); hide(frame, false); frame.scrollIntoView(); } }, w("show_report", { name: file.split("/")[0] })));
    const result = await content(there);
    rows(table, result ? [result] : [], shown);
    hide(next, !found.plans.includes(`${session.value}/${PROPOSED}`));
    update();
  }
  function shown(result) {
    const next = (result.next_measurements || []).slice(0, 5);
    const light = result.usable ? w(`usable_${result.usable}`) : result.verdict;
    const reasons = [...new Set((result.reason || "").split("; "))].join("; "); // the same may be said of several configurations
    const places = [...new Set((result.anomalies || []).map((one) => one.location && one.location.place).filter(Boolean))];
    return h("div", {}, h("p", { class: "number" }, light), h("p", {}, reasons),
      places.length ? h("p", {}, w("result_places", { places: places.join(", ") })) : null,
      result.next_step ? h("p", { id: "next_step" }, `→ ${result.next_step}`) : null,
      h("table", {}, h("thead", {}, h("tr", {}, ...["joint", "value", "interval", "nominal"].map((one) => h("th", { scope: "col" }, w(`column_${one}`))))),
        h("tbody", {}, ...(result.stiffness || []).map(joint))),
      ...next.length ? [h("h3", {}, w("next_measurements")), h("ul", {}, ...next.map((one) => h("li", {}, one.why)))] : []);
  }
  const mega = (value) => (value === null || value === undefined ? "–" : number(value / 1e6, 3));
  function joint(one) {
    const nominal = (state.cell.nominal || {})[one.joint];
    const found = one.identifiable && one.value !== null;
    const change = found && nominal ? ` (${one.value >= nominal ? "+" : ""}${number(100 * (one.value / nominal - 1))} %)` : "";
    const interval = found && one.interval_95 ? one.interval_95.map(mega).join(" … ") : "–";
    return h("tr", {}, h("th", { scope: "row" }, one.joint), h("td", {}, found ? mega(one.value) : w("not_identifiable")),
      h("td", {}, interval), h("td", {}, nominal ? `${mega(nominal)}${change}` : "–"));
  }
  session.addEventListener("change", chosen);
  function update() {
    const mine = Boolean(state.me.control);
    const work = state.work_evaluation;
    const busy = Boolean(work) && work.share < 1;
    text(how, state.ended || "");
    for (const one of buttons) one.disabled = !mine || busy || !session.value;
    hide(cancel, !busy);
    cancel.disabled = !mine;
    hide(bar, !busy);
    inside.style.width = `${Math.round(100 * (work ? work.share : 0))}%`;
    text(doing, !work ? "" : busy ? work.text : work.failed ? `${w("not_done")}: ${work.text}` : w("evaluated", { text: work.text }));
    const now = JSON.stringify(work && !busy ? work : null);
    if (now !== finished) {
      finished = now;
      setTimeout(opened, 100);
    }
  }
  return { node, update, opened };
}
