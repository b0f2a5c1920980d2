// The way to the server: requests by POST with the session's token, and a WebSocket that tells the state.
const LOOK = 100; // ms between two looks at whether something has come
const HELD = 300; // ms between two looks, from which on the page itself was held up
const LATE = 700; // ms without a word, after which the page counts as cut off
let token = "";

async function post(path, body) {
  const headers = { "Content-Type": "application/json", "X-Panel-Token": token };
  const answer = await fetch(path, { method: "POST", headers, body: JSON.stringify(body), cache: "no-store" });
  const found = await answer.json().catch(() => ({ text: answer.statusText }));
  return { status: answer.status, ...found };
}
export async function enter(secret, name) {
  const found = await post("/api/enter", { token: secret, name });
  if (found.status === 200) token = found.token;
  return found;
}
export async function me() {
  const answer = await fetch("/api/me", { cache: "no-store" });
  if (!answer.ok) return null;
  const found = await answer.json();
  token = found.token;
  return found;
}
export async function ask(name, body = {}) {
  try {
    return await post(`/api/do/${name}`, body);
  } catch (error) {
    return { status: 0, done: false, text: String(error) };
  }
}
export const device = () => post("/api/device", {});
export const leave = () => post("/api/leave", {});
export async function folder() {
  const answer = await fetch("/api/folder", { cache: "no-store" });
  return answer.ok ? answer.json() : { plans: [], sessions: [] };
}

// Keeps a connection: `hear` takes what is new, `lost` is told whether the page is cut off, `out` that it has to enter.
export function connect(hear, lost, out) {
  let heard = performance.now();
  let socket = null;
  let again = 0;
  const open = () => {
    const kind = location.protocol === "https:" ? "wss" : "ws";
    socket = new WebSocket(`${kind}://${location.host}/pages`);
    socket.addEventListener("message", (event) => {
      heard = performance.now();
      hear(JSON.parse(event.data));
    });
    socket.addEventListener("close", () => {
      clearTimeout(again);
      again = setTimeout(async () => {
        const who = await me().catch(() => undefined);
        if (who === null) out();
        else open();
      }, 400);
    });
  };
  open();
  let looked = performance.now();
  let waited = false;
  setInterval(() => {
    const now = performance.now();
    const held = now - looked > HELD;
    looked = now;
    waited = held && !waited;
    if (waited) return; // this page was held up itself: what has come meanwhile is heard before it is missed
    const late = now - heard > LATE;
    lost(late);
    if (late && socket.readyState === WebSocket.OPEN && now - heard > 4000) socket.close();
  }, LOOK);
}
