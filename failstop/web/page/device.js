// Device: what this device may do, and how to pair it so that it may do more.
import {inTurn, post} from "/link.js";
import {forget, keep} from "/keys.js";

const $ = (id) => document.getElementById(id);

const AGAIN_MS = 2000;
let asked = 0, shown = 0; // an answer that arrives after a later one is ignored

function show({pairing, device, drive, lacks}, number = ++asked) {
  if (number < shown) return;
  shown = number;
  const rights = device ? `This device (${device}) can watch, stop, reset and enable the robot.` : "This device can watch and stop the robot.";
  $("role").textContent = lacks ? `${rights} It can't drive, because ${lacks}.` : rights;
  $("pair").hidden = !pairing || !!device;
  $("forget").hidden = !device;
  dispatchEvent(new CustomEvent("device", {detail: {device, drive}}));
  if (device) toldWhy("");
}

// STOP covers the lower end of the screen, so scroll the text above it.
function toldWhy(text) {
  $("pair-why").textContent = text;
  if (text) $("pair-why").scrollIntoView({block: "nearest"});
}

async function look() {
  const number = ++asked;
  try {
    const found = await inTurn((signal) => fetch("/api/me", {cache: "no-store", signal}).then((answer) => answer.ok && answer.json()));
    if (found) show(found, number);
  } catch { if (number === asked) setTimeout(look, AGAIN_MS); }
}

document.querySelector("#pair form").addEventListener("submit", async (event) => {
  event.preventDefault();
  toldWhy("");
  try {
    const found = await post("/api/pair", {code: $("code").value, name: $("device-name").value});
    if (!found.ok) { toldWhy(found.error); return; }
    if (globalThis.crypto && crypto.subtle) await keep(found.key);
    $("code").value = "";
    dispatchEvent(new Event("paired"));
    show({pairing: true, device: found.device});
  } catch {
    toldWhy("The robot could not be reached. Try again.");
  }
});

$("forget").addEventListener("click", async () => {
  const found = await post("/api/forget").catch(() => ({}));
  if (found.ok) { await forget().catch(() => {}); show({pairing: true, device: null}); }
});

// A code from a photographed QR code follows the #, which is not sent to any server; remove it from the history at once.
const given = location.hash.slice(1);
if (/^[\w-]+$/.test(given)) {
  history.replaceState(null, "", location.pathname);
  $("code").value = given;
  $("pair").open = true;
  addEventListener("device", () => { if (!$("pair").hidden) $("device-name").focus(); }, {once: true});
}
addEventListener("link-open", look);
look();
