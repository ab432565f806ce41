// Hands: what may move the robot, or let it go faster, is held for two seconds; the rest happens at a touch. Letting go, or
// anything unexpected, cancels.
import {post} from "/link.js";

const $ = (id) => document.getElementById(id);
const HOLD_MS = 2000;
let can = {}, limit = 100, holding = null;

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
    said("The robot was not reached: nothing was changed, as far as is known.", true);
  }
}

function cancel() {
  if (!holding) return;
  clearTimeout(holding.timer);
  holding.button.classList.remove("held");
  holding = null;
}

function begin(button) {
  cancel();
  const {verb, percent} = button.dataset;
  if (can[verb]) { said(`Not now: ${can[verb]}.`, true); return; }
  if (verb === "disable" || percent <= limit) { ask(button.dataset); return; }
  button.classList.add("held");
  holding = {button, timer: setTimeout(() => { cancel(); if (navigator.vibrate) navigator.vibrate(30); ask(button.dataset); }, HOLD_MS)};
}

for (const button of document.querySelectorAll("#hands button")) {
  button.addEventListener("pointerdown", (event) => {
    if (!event.isPrimary || event.button) return;
    button.setPointerCapture(event.pointerId);
    begin(button);
  });
  for (const end of ["pointerup", "pointercancel", "lostpointercapture", "blur"]) button.addEventListener(end, cancel);
  button.addEventListener("contextmenu", (event) => event.preventDefault());
  button.addEventListener("keydown", (event) => { if (event.key === "Enter" && !event.repeat) begin(button); });
  button.addEventListener("keyup", cancel);
}
addEventListener("visibilitychange", cancel);
addEventListener("stopped", () => { cancel(); said("", false); });
addEventListener("link-lost", cancel);
addEventListener("face", (event) => {
  ({can, limit} = event.detail);
  for (const button of document.querySelectorAll("#limit button")) {
    button.setAttribute("aria-pressed", Number(button.dataset.percent) === limit);
  }
  for (const [verb, why] of Object.entries(can)) {
    $(verb).setAttribute("aria-disabled", why ? "true" : "false");
    $(`${verb}-why`).textContent = why;
    if (why && holding && holding.button === $(verb)) cancel();
  }
});
addEventListener("device", (event) => { $("hands").hidden = !event.detail.device; });
