// Words of the page in the reader's language; a code without words is shown as it is, and texts of nodes are English.
let words = {};
export let language = "en";
let place = 0; // of the language in a row of words

export async function speak(wanted) {
  language = wanted === "de" ? "de" : "en";
  place = wanted === "de" ? 1 : 0;
  words = await (await fetch("/static/words.json")).json();
  document.documentElement.lang = language;
}
export function w(key, values = {}) {
  const found = key in words ? words[key][place] : key;
  return found.replace(/\{(\w+)\}/g, (_, name) => String(values[name] ?? ""));
}
export function known(key) {
  return key in words;
}
export function number(value, digits = 0) {
  if (value === null || value === undefined) return "–";
  return value.toLocaleString(language, { minimumFractionDigits: digits, maximumFractionDigits: digits, signDisplay: "negative" });
}
export function duration(seconds) {
  if (seconds === null || seconds === undefined) return "–";
  const minutes = Math.round(seconds / 60);
  return minutes >= 60 ? `${Math.floor(minutes / 60)} h ${minutes % 60} min` : `${Math.max(minutes, 1)} min`;
}
