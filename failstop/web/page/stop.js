"use strict";
// STOP, by itself: it is part of the page, needs no other file, and works before anything is connected. It has its own
// websocket, because all six requests that a browser keeps open may be in use, and it falls back to requests if there is
// no websocket. It keeps trying until a stop is written, for as long as the page is open.
(() => {
  const EVERY_MS = 300; // an answer comes within this time, whether the stop was written or not
  const LATER_MS = 2000;
  const OFTEN = 60; // after this many tries it tries less often
  const TOLD = 3; // after this many tries the page says that the stop is not written
  const ASIDE_MS = 4;
  const MOST_OPEN = 3; // of the six requests that a browser has open at a time
  const PATIENT_MS = 3000; // how long to wait for the answer to a request, and for a connection
  const SILENT_MS = 1000; // after this long without an answer, a websocket counts as broken
  const CHECK_MS = 5000;
  const EARLY_S = 0.5; // how much earlier than its request a stop may seem, by the robot's clock
  const CLICK_MS = 1000; // a click this soon after a touch belongs to the touch
  const button = document.getElementById("stop");
  const said = document.getElementById("stop-said"), heard = document.getElementById("alarm");
  const HINT = matchMedia("(pointer: coarse)").matches ? "at a touch" : "or press Space or Escape";
  let touched = -CLICK_MS, socket = null, spare = null, given = null, view = null, now = null, wait = EVERY_MS, refused = "", rests = false;

  function say(text, phase) {
    rests = false;
    said.textContent = text;
    button.dataset.phase = phase;
    const alarm = phase === "failed" ? text : "";
    if (heard.textContent !== alarm) heard.textContent = alarm; // setting the same text again would make a screen reader repeat it
  }

  function rest() {
    if (refused && !isOpen()) say(`THIS PAGE CAN'T STOP (${refused}): use the POWER SWITCH`, "failed");
    else say(HINT, "");
    rests = true;
  }

  function isOpen() {
    return socket && socket.readyState === WebSocket.OPEN;
  }

  // A silent connection takes minutes to end, so open another one next to it, which takes its place.
  function connect() {
    const made = new WebSocket(`${location.protocol.endsWith("s:") ? "wss" : "ws"}://${location.host}/api/stop/live`);
    const again = () => {
      if (socket !== made) return;
      socket = null;
      setTimeout(() => { if (!socket) connect(); }, wait);
      wait = Math.min(2 * wait, LATER_MS);
    };
    if (isOpen()) spare = socket;
    socket = made;
    given = null;
    made.onmessage = (event) => { given = null; hear(JSON.parse(event.data)); };
    made.onopen = () => {
      wait = EVERY_MS;
      if (spare) spare.close();
      spare = null;
      if (now) send(now.last); else if (rests) rest();
    };
    made.onclose = again;
    setTimeout(() => { if (made.readyState === WebSocket.CONNECTING) { made.close(); again(); } }, PATIENT_MS);
  }

  function send(id) {
    if (!isOpen()) return false;
    socket.send(JSON.stringify({stop: id}));
    given = given || performance.now();
    return true;
  }

  function reconnect() {
    if (!socket || socket.readyState !== WebSocket.CONNECTING) connect();
  }

  // keepalive: it goes out even if the page is closed at once.
  function ask(path, body, signal) {
    const headers = {"X-Failstop": "1"};
    return fetch(path, {method: "POST", headers, body: JSON.stringify(body), keepalive: true, signal})
      .then((answer) => answer.json().then((found) => ({...found, ok: answer.ok})));
  }

  function request(own) {
    const at = performance.now(), each = {since: at, given: new AbortController()};
    own.open.filter(({since}) => at - since > PATIENT_MS).forEach((old) => old.given.abort());
    if (own.open.length >= MOST_OPEN) return;
    const id = own.last;
    own.open.push(each);
    ask("/api/stop", {id}, each.given.signal).then((found) => hear({id, ...found})).catch(() => {})
      .finally(() => { own.open = own.open.filter((other) => other !== each); });
  }

  function hear(found) {
    const stop = now;
    if (!stop || !String(found.id).startsWith(stop.id)) return;
    stop.asked ||= found.asked || 0;
    stop.wrong = found.error || "";
    stop.latched = !!found.view && found.view.latched;
    if (found.written) done(stop, {...found, asked: stop.asked, sent: stop.sent[found.id]});
  }

  function done(stop, found) {
    if (now !== stop) return;
    now = null;
    stop.open.forEach((each) => each.given.abort());
    say("written", "written");
    dispatchEvent(new CustomEvent("stopped", {detail: found}));
  }

  async function stop() {
    const id = Math.random().toString(36).slice(2);
    const own = now = {id, last: id, sent: {[id]: performance.now()}, open: [], asked: 0, wrong: "no answer", latched: false, before: view && view.stop && view.stop.id};
    const sent = send(id);
    dispatchEvent(new Event("stopping")); // requests that can wait give up their connections
    // Work of the browser on a picture or a request would delay the bytes of the websocket.
    if (sent) await new Promise((go) => setTimeout(go, ASIDE_MS));
    if (now === own) say("asking ...", "asking");
    if (navigator.vibrate) navigator.vibrate(40);
    for (let number = 0; now === own; number++) {
      own.last = number ? `${id}-${number}` : id; // each try is a new stop, because the last may be lost; both ways send the same one
      own.sent[own.last] ||= performance.now();
      if (number && !send(own.last) || given && performance.now() - given > SILENT_MS) reconnect();
      request(own);
      await new Promise((next) => setTimeout(next, number < OFTEN ? EVERY_MS : LATER_MS));
      if (now === own && number >= TOLD) {
        const what = own.latched ? "latched, NOT YET AT THE BOARD" : `NOT WRITTEN (${own.wrong || "not yet"})`;
        say(`${what}. Still trying: use the POWER SWITCH`, "failed");
      }
    }
    own.open.forEach((each) => each.given.abort());
  }

  // Check whether the robot accepts requests at all, so that people learn that this page can't stop before it matters.
  async function check() {
    try {
      const found = await ask("/api/check");
      refused = found.ok ? "" : found.error || "its requests are refused";
      if (refused && !isOpen()) document.getElementById("why").textContent = "The robot refuses this page's requests.";
      if (rests) rest();
    } catch { setTimeout(check, CHECK_MS); }
  }

  // The robot's state may show that the stop is written before an answer does. Only a stop that came after the robot has heard
  // of this touch counts: somebody else's earlier stop, of which the page hears late, must not end the tries.
  addEventListener("view", ({detail}) => {
    view = detail;
    if (!now || !now.asked || !view.latched || !view.stop || !view.stop.written) return;
    const newer = view.stop.id !== now.before && view.stop.t >= now.asked - EARLY_S;
    if (newer) done(now, {asked: now.asked, written: true});
  });
  addEventListener("paired", connect); // the robot looks at the pairing only when a connection begins
  addEventListener("unstopped", () => { if (!now) rest(); });
  rest();
  // Stop at touch-down, not when the finger is lifted. A click without a touch comes from a screen reader or a keyboard.
  button.addEventListener("pointerdown", (event) => { event.preventDefault(); touched = event.timeStamp; stop(); });
  button.addEventListener("click", (event) => { if (event.timeStamp - touched > CLICK_MS) stop(); });
  addEventListener("keydown", (event) => {
    const writes = event.target.closest && event.target.closest("input");
    if (event.key === "Escape" || (event.key === " " && !writes)) {
      event.preventDefault();
      if (!event.repeat) stop();
    }
  }, true);
  connect();
  setTimeout(check, EVERY_MS);
})();
