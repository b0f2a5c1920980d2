// A question above the stop, which stays within reach: nothing covers it and nothing waits for the answer.
import { h } from "./dom.js";
import { w } from "./words.js";

export function sure(key, reason = false) {
  document.getElementById("sure")?.remove();
  return new Promise((answer) => {
    const words = h("input", { id: "sure_reason", maxLength: 500, "aria-label": w("reason") });
    const end = (value) => { box.remove(); answer(value); };
    const box = h("div", { id: "sure", class: "card", role: "alertdialog", "aria-label": w(key) }, h("p", {}, w(key)), reason ? words : null,
      h("div", { class: "row" },
        h("button", { id: "sure_yes", class: "main grow", onclick: () => { if (!reason || words.value.trim().length > 2) end(reason ? words.value.trim() : true); } }, w("yes")),
        h("button", { id: "sure_no", class: "grow", onclick: () => end(false) }, w("no"))));
    document.getElementById("foot").prepend(box);
    (reason ? words : box.querySelector("button")).focus();
  });
}
