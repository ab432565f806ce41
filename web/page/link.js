// The link: a websocket that comes back by itself, and plain requests while it does not.
const LEAST_MS = 250, MOST_MS = 2000, POLL_MS = 500;
let socket = null;

export function connected() {
  return !!socket && socket.readyState === WebSocket.OPEN;
}

export function send(message) {
  if (connected()) socket.send(JSON.stringify(message));
}

addEventListener("stopping", (event) => {
  if (!connected()) return;
  event.preventDefault(); // it is on its way
  send({stop: event.detail});
});

export function reconnect() {
  if (socket) socket.close();
}

export function connect(news) {
  let wait = LEAST_MS, polling = 0;
  const poll = () => fetch("/api/state", {cache: "no-store"}).then((answer) => answer.ok && answer.json())
    .then((found) => { if (found && !connected()) news(found); }).catch(() => {});
  const open = () => {
    socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/live`);
    socket.onopen = () => { wait = LEAST_MS; clearInterval(polling); polling = 0; dispatchEvent(new Event("link-open")); };
    socket.onmessage = (event) => news(JSON.parse(event.data));
    socket.onclose = () => {
      dispatchEvent(new Event("link-lost"));
      if (!polling) polling = setInterval(poll, POLL_MS);
      setTimeout(open, wait);
      wait = Math.min(2 * wait, MOST_MS);
    };
  };
  open();
}

export async function post(path, body) {
  const answer = await fetch(path, {method: "POST", headers: {"X-Failstop": "1"}, body: JSON.stringify(body || {})});
  const found = await answer.json();
  return {ok: answer.ok, ...found};
}
