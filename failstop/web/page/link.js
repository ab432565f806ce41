// Link: a websocket that connects again by itself, and plain requests while the websocket is silent. Requests that can wait
// are sent one at a time and given up when somebody stops, because a browser opens only six at a time, and STOP needs one.
const ASK_MS = 500, MOST_KNOWN_MS = 1000;
const LEAST_MS = 250, MOST_MS = 2000, POLL_MS = 500, SILENT_MS = 1500, DEAD_MS = 6000, PATIENT_MS = 10000, QUIET_MS = 1000;
let socket = null, wait = LEAST_MS, heard = 0, line = Promise.resolve(), current = null, posting = null, stopped = -QUIET_MS;

const rest = (ms) => new Promise((go) => setTimeout(go, ms));

export function connected() {
  return !!socket && socket.readyState === WebSocket.OPEN;
}

export function send(message) {
  if (connected()) socket.send(JSON.stringify(message));
  return connected();
}

export function reconnect() {
  if (socket) socket.close();
}

// A network may deliver everything, but seconds late. So the page sends its time again and again, and each message from the robot
// has the newest time that the robot has received, and how long before the message that was (ms). So the page knows the earliest
// time at which the robot can have sent the message. The questions go out when messages come, because a browser slows down
// the timers of a page that is hidden.
function sentAt([asked, passed]) {
  return Math.min(performance.now(), asked + Math.min(passed, MOST_KNOWN_MS));
}

// Replace a websocket that neither opens nor fails, or that has gone silent, because closing it may take minutes.
function open(news) {
  const made = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/live`);
  const begun = performance.now();
  let ended = false, asked = -Infinity, since = begun;
  const ask = () => {
    const at = performance.now();
    if (at - asked < ASK_MS || made.readyState !== WebSocket.OPEN) return;
    asked = at;
    made.send(JSON.stringify({asked: Math.ceil(at)}));
  };
  const end = () => {
    if (ended) return;
    ended = true;
    clearInterval(watch);
    made.close();
    dispatchEvent(new Event("link-lost"));
    setTimeout(() => open(news), wait);
    wait = Math.min(2 * wait, MOST_MS);
  };
  const watch = setInterval(() => { if (performance.now() - Math.max(begun, heard) > DEAD_MS) end(); }, POLL_MS);
  socket = made;
  made.onopen = () => { if (!ended) { wait = LEAST_MS; ask(); dispatchEvent(new Event("link-open")); } };
  made.onclose = end;
  made.onmessage = (event) => {
    if (ended) return;
    const message = JSON.parse(event.data);
    heard = performance.now();
    ask();
    if ("asked" in message) since = Math.max(since, sentAt(message.asked)); // messages arrive in their order
    if ("hold" in message) dispatchEvent(new CustomEvent("hold", {detail: message})); else news(message, since);
  };
}

export async function connect(news) {
  open(news);
  for (;;) {
    await rest(POLL_MS);
    if (performance.now() - heard < SILENT_MS) continue;
    const begun = performance.now();
    const found = await patiently((signal) => fetch("/api/state", {cache: "no-store", signal})
      .then((answer) => answer.ok && answer.json()), MOST_MS).catch(() => null);
    if (found && performance.now() - heard >= SILENT_MS) news(found, begun);
  }
}

async function patiently(work, most, given = new AbortController()) {
  const timer = setTimeout(() => given.abort(), most);
  try { return await work(given.signal); } finally { clearTimeout(timer); }
}

// Do something that can wait. `work` gets a signal that tells it when to give up.
export function inTurn(work) {
  const done = line.then(async () => {
    while (performance.now() - stopped < QUIET_MS) await rest(QUIET_MS);
    current = new AbortController();
    return patiently(work, PATIENT_MS, current);
  });
  line = done.catch(() => {});
  return done;
}

addEventListener("stopping", () => {
  stopped = performance.now();
  if (current) current.abort();
});

// A new request replaces an earlier one that has no answer yet.
export function post(path, body) {
  if (posting) posting.abort();
  posting = new AbortController();
  return patiently(async (signal) => {
    const answer = await fetch(path, {method: "POST", headers: {"X-Failstop": "1"}, body: JSON.stringify(body || {}), signal});
    const found = await answer.json();
    return {ok: answer.ok, ...found};
  }, PATIENT_MS, posting);
}
