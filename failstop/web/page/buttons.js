// Buttons: a button that may let the robot move, or move faster, must be held for two seconds. Any other button needs only a
// touch. Letting go, sliding off, or anything unexpected cancels the hold. The robot measures the time: this page reports that
// a hold begins, and then again and again that it lasts. When the robot asks, the page confirms that it still lasts.
import {post, send} from "/link.js";
import {TOO_OLD, answer} from "/alive.js";

const $ = (id) => document.getElementById(id);
const TICK_MS = 100, LATE_MS = 400, SETTLES_MS = 30;
const ASKED_MS = 1000; // after this long without a question from the robot, this device does not attend
const CLICK_MS = 3000; // a click this soon after a touch belongs to the touch
let touched = -CLICK_MS, can = {}, limit = 100, epoch = 0, holding = null, asking = "", chosen = true, askedAt = -Infinity;

function said(text, refused) {
  $("answer").textContent = text;
  $("answer").classList.toggle("refused", refused);
}

async function ask({verb, percent}) {
  said("asking ...", false);
  try {
    const found = await post(`/api/${verb}`, {percent: Number(percent)});
    said(found.said || found.error, !found.ok);
  } catch {
    said("The robot could not be reached. As far as this page knows, nothing changed.", true);
  }
}

function cancel(why) {
  if (!holding) return;
  const {button, id, timer} = holding;
  holding = null;
  clearInterval(timer);
  button.classList.remove("held");
  send({released: id});
  if (typeof why === "string") said(why, true);
}

// If this page was held up, it may have missed that the button was let go.
function late() {
  const at = performance.now(), gap = at - holding.at;
  holding.at = at;
  if (gap > TICK_MS + LATE_MS) cancel("Cancelled, because this page was held up. Hold again.");
  return !holding;
}

function begin(button) {
  cancel();
  const {verb, percent} = button.dataset, id = Math.random().toString(36).slice(2);
  if (can[verb]) { said(`Not now: ${can[verb]}.`, true); return; }
  if (verb === "disable" || percent <= limit) { ask(button.dataset); return; }
  if (TOO_OLD) { said(TOO_OLD, true); return; }
  if (!send({hold: verb, id, epoch, percent: Number(percent) || 0})) { said("Not now: there is no connection to the robot. Try again.", true); return; }
  said("", false);
  button.classList.add("held");
  const tick = () => { if (!late()) send({held: id}); };
  holding = {button, id, at: performance.now(), timer: setInterval(tick, TICK_MS)};
}

// If the browser answers, it has delivered everything that the finger has done until now.
async function enough(id) {
  const begun = performance.now();
  await answer().catch(cancel);
  await new Promise((go) => requestAnimationFrame(() => setTimeout(go, SETTLES_MS)));
  if (!holding || holding.id !== id || late() || performance.now() - begun > LATE_MS) { cancel(); return; }
  if (navigator.vibrate) navigator.vibrate(30);
  clearInterval(holding.timer);
  holding.button.classList.remove("held");
  holding = null;
  asking = id;
  said("asking ...", false);
  send({sure: id});
}

// A screen reader's click is over at once. It works for buttons that need a touch, and explains how to hold the others.
function click(button) {
  const {verb, percent} = button.dataset;
  if (can[verb] || verb === "disable" || percent <= limit) begin(button);
  else said("Hold this button for 2 s, with a finger or with Enter (in a screen reader's focus mode).", true);
}

function isOn(button, {clientX, clientY}) {
  const {left, right, top, bottom} = button.getBoundingClientRect();
  return clientX >= left && clientX <= right && clientY >= top && clientY <= bottom;
}

for (const button of document.querySelectorAll("#buttons button")) {
  button.addEventListener("pointerdown", (event) => {
    touched = event.timeStamp;
    if (!event.isPrimary || event.button) return;
    button.setPointerCapture(event.pointerId);
    begin(button);
  });
  button.addEventListener("pointermove", (event) => { if (!isOn(button, event)) cancel(); });
  button.addEventListener("pointerup", (event) => { touched = event.timeStamp; });
  for (const end of ["pointerup", "pointercancel", "lostpointercapture", "blur"]) button.addEventListener(end, cancel);
  button.addEventListener("contextmenu", (event) => event.preventDefault());
  button.addEventListener("keydown", (event) => {
    if (event.key !== "Enter") return;
    event.preventDefault(); // so that no click follows
    if (!event.repeat) begin(button);
  });
  button.addEventListener("click", (event) => { if (event.timeStamp - touched > CLICK_MS) click(button); });
  button.addEventListener("keyup", cancel);
}
addEventListener("visibilitychange", cancel);
addEventListener("stopping", () => { cancel(); said("", false); });
addEventListener("link-lost", () => {
  cancel();
  if (asking) said("The connection was lost. The top of the page shows whether it was done.", true);
  asking = "";
});
addEventListener("hold", ({detail: {hold, enough: long, done, said: text}}) => {
  if (long) { enough(hold); return; }
  if (holding && holding.id === hold) cancel();
  else if (asking !== hold) return;
  asking = "";
  said(text, !done);
});
// After a device begins to attend, its stick works only once a limit was chosen. Until then, no limit is marked as chosen.
function showLimit() {
  if (performance.now() - askedAt > ASKED_MS) chosen = true;
  $("limit").dataset.percent = limit;
  $("limit").dataset.chosen = chosen;
  $("limit-how").textContent = `${chosen ? "" : "choose one before you drive; "}tap to lower, hold 2 s to raise`;
  for (const button of document.querySelectorAll("#limit button")) {
    button.setAttribute("aria-pressed", chosen && Number(button.dataset.percent) === limit);
  }
}

addEventListener("lease", ({detail}) => {
  if (!("chosen" in detail)) return;
  askedAt = performance.now();
  if (chosen !== detail.chosen) { ({chosen} = detail); showLimit(); }
});
addEventListener("view", (event) => {
  ({can, limit} = event.detail);
  if (holding && event.detail.epoch !== epoch) cancel("Cancelled, because the robot was stopped. Look at the stop first, then hold again.");
  ({epoch} = event.detail);
  showLimit();
  for (const [verb, why] of Object.entries(can)) {
    $(verb).setAttribute("aria-disabled", why ? "true" : "false");
    $(`${verb}-why`).textContent = why;
    if (why && holding && holding.button === $(verb)) cancel();
  }
});
addEventListener("device", (event) => { $("buttons").hidden = !event.detail.device; });
