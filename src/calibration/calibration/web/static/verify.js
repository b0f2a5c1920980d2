// Verification: a model on a session that it was not identified from, against a tolerance; and the plan for one.
import { h, text, options, rows } from "./dom.js";
import { w, number } from "./words.js";
import { ask } from "./link.js";

const MILLIMETRES = 1000;
const decimal = (field) => Number(field.value.replace(",", ".")) || 0;

// The model and the tolerance that it is held against.
export function target(prefix) {
  const model = h("select", { id: `${prefix}_model` });
  const tolerance = h("input", { id: `${prefix}_tolerance`, inputMode: "decimal", size: 6, autocomplete: "off" });
  return {
    fields: [h("label", { for: model.id }, w("model")), model, h("label", { for: tolerance.id }, w("tolerance")), tolerance],
    offer(models) { options(model, models.map((one) => [one, one]), true); },
    get ready() { return Boolean(model.value) && decimal(tolerance) > 0; },
    get value() { return { model: model.value, tolerance: decimal(tolerance) / MILLIMETRES }; },
  };
}

export function verification(session, told) {
  const against = target("verify");
  const fit = h("input", { id: "fit_tracker", type: "checkbox" });
  const button = h("button", { id: "verify", class: "main", onclick: () =>
    ask("verify", { session: session.value, ...against.value, fit_tracker: fit.checked }).then(told) }, w("verify"));
  const doing = h("p", { id: "verifying", "aria-live": "polite" });
  const verdict = h("div", { id: "verified" });
  const node = h("section", { class: "card", "aria-label": w("verification") }, h("h2", {}, w("verification")),
    h("p", {}, w("verify_how")), ...against.fields, h("div", { class: "check" }, fit, h("label", { for: "fit_tracker" }, w("fit_tracker"))), button, doing, verdict);
  return {
    node,
    offer: against.offer,
    show(result) {
      rows(verdict, result ? [result] : [], (one) => h("div", {}, h("p", { class: "number" }, one.decision ? w(`decision_${one.decision}`) : w(`usable_${one.usable}`)),
        h("p", {}, one.decision ? w("verified_error", { max: number(MILLIMETRES * one.error.after.max, 3), u: number(MILLIMETRES * one.uncertainty.expanded, 3), tolerance: number(MILLIMETRES * one.tolerance, 3) }) : one.reason || "")));
    },
    update(possible, work) {
      const busy = Boolean(work) && work.share < 1;
      button.disabled = !possible || busy || !against.ready;
      text(doing, !work ? "" : busy ? `${number(100 * work.share)} % ${work.text}` : work.failed ? `${w("not_done")}: ${work.text}` : w("evaluated", { text: work.text }));
    },
  };
}
