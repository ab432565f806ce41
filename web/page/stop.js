"use strict";
// STOP, by itself: it stands in the page, needs nothing else of it, and works before anything is connected.
(() => {
  const EVERY_MS = 300; // an answer comes within that when it is written, or says that it was not
  const TRIES = 60;
  const ASIDE_MS = 4;
  const MOST_OPEN = 4;
  const button = document.getElementById("stop");
  const said = document.getElementById("stop-said");
  const HINT = matchMedia("(pointer: coarse)").matches ? "at a touch" : "so do Space and Escape";
  let newest = "";

  function say(text, phase) {
    said.textContent = text;
    button.dataset.phase = phase;
  }

  function ask(open, id) {
    const given = new AbortController();
    open.push(given);
    if (open.length > MOST_OPEN) open.shift().abort();
    // keepalive: it goes out even if the page is closed at once.
    const headers = {"X-Failstop": "1"}, body = JSON.stringify({id});
    return fetch("/api/stop", {method: "POST", headers, body, keepalive: true, signal: given.signal})
      .then((answer) => answer.json().then((found) => ({...found, status: answer.status})));
  }

  async function stop() {
    const id = Math.random().toString(36).slice(2);
    // Where the websocket is up it is the shorter way, as it needs no new request; by its id the robot knows it for the same.
    const sent = !dispatchEvent(new CustomEvent("stopping", {detail: id, cancelable: true}));
    const open = [];
    newest = id;
    say("asking ...", "asking");
    if (navigator.vibrate) navigator.vibrate(40);
    // What the browser does for a request would hold up the bytes of the websocket.
    if (sent) await new Promise((go) => setTimeout(go, ASIDE_MS));
    let asked = 0, done = false, wrong = "no answer";
    for (let number = 0; number < TRIES && !done; number++) {
      const wait = new Promise((next) => setTimeout(next, EVERY_MS));
      const answer = ask(open, number ? `${id}-${number}` : id).then((found) => {
        asked ||= found.asked || 0;
        if (found.written && !done) {
          done = true;
          if (newest === id) say("written", "written");
          dispatchEvent(new CustomEvent("stopped", {detail: {...found, asked}}));
        } else if (found.error) wrong = found.error;
      }).catch(() => {});
      await Promise.race([answer, wait]);
      if (!done) await wait;
      if (newest !== id && number) break; // touched anew: that one goes on
      if (!done && number >= 3) say(`NOT WRITTEN (${wrong}). Still trying: use the POWER SWITCH`, "failed");
    }
    open.forEach((given) => given.abort());
    if (!done && newest === id) say(`NOT WRITTEN (${wrong}): use the POWER SWITCH`, "failed");
  }

  addEventListener("unstopped", () => say(HINT, ""));
  say(HINT, "");
  // On touch-down, not when the finger is lifted; a click without one is a screen reader's or a keyboard's.
  button.addEventListener("pointerdown", (event) => { event.preventDefault(); stop(); });
  button.addEventListener("click", (event) => { if (!event.detail) stop(); });
  addEventListener("keydown", (event) => {
    const writes = event.target.closest && event.target.closest("input");
    if (event.key === "Escape" || (event.key === " " && !writes)) {
      event.preventDefault();
      if (!event.repeat) stop();
    }
  }, true);
})();
