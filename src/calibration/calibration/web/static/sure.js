// A question above the stop, which stays within reach: nothing covers it and nothing waits for the answer.
import { h } from "./dom.js";
import { w } from "./words.js";

let dismiss = () => {}; // answers the question that is open with no

export function sure(key, reason = false, least = 3) {
  dismiss();
  return new Promise((answer) => {
    const before = document.activeElement;
    const words = h("input", { id: "sure_reason", maxLength: 500, "aria-label": w(key) });
    const no = h("button", { id: "sure_no", class: "grow", onclick: () => end(false) }, w("no"));
    const box = h("div", { id: "sure", class: "card", role: "alertdialog", "aria-label": w(key) }, h("p", {}, w(key)), reason ? words : null,
      h("div", { class: "row" },
        h("button", { id: "sure_yes", class: "main grow", onclick: () => { if (!reason || words.value.trim().length >= least) end(reason ? words.value.trim() : true); } }, w("yes")),
        no));
    const escape = (event) => { if (event.key === "Escape") end(false); };
    const end = (value) => {
      const inside = box.contains(document.activeElement);
      dismiss = () => {};
      document.removeEventListener("keydown", escape);
      box.remove();
      if (inside) before.focus();
      answer(value);
    };
    dismiss = () => end(false);
    document.addEventListener("keydown", escape);
    document.getElementById("foot").prepend(box);
    (reason ? words : no).focus(); // what does nothing
  });
}
