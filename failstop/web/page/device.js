// Device: what this one may, and how it comes to may more.
import {inTurn, post} from "/link.js";
import {forget, keep} from "/keys.js";

const $ = (id) => document.getElementById(id);

const AGAIN_MS = 2000;
let asked = 0, shown = 0; // an answer that comes after a later one is old

function show({pairing, device, drive, lacks}, number = ++asked) {
  if (number < shown) return;
  shown = number;
  const rights = device ? `${device}: it sees, stops, resets and enables.` : "It sees, and it stops.";
  $("role").textContent = lacks ? `${rights} It can't drive, because ${lacks}.` : rights;
  $("pair").hidden = !pairing || !!device;
  $("forget").hidden = !device;
  dispatchEvent(new CustomEvent("device", {detail: {device, drive}}));
  if (device) toldWhy("");
}

// STOP covers the lower end of the screen: what is said is brought above it.
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
    toldWhy("The robot was not reached.");
  }
});

$("forget").addEventListener("click", async () => {
  const found = await post("/api/forget").catch(() => ({}));
  if (found.ok) { await forget().catch(() => {}); show({pairing: true, device: null}); }
});

// A photographed code stands behind the #, which is sent to nobody; it is taken out of the history at once.
const given = location.hash.slice(1);
if (/^[\w-]+$/.test(given)) {
  history.replaceState(null, "", location.pathname);
  $("code").value = given;
  $("pair").open = true;
  addEventListener("device", () => { if (!$("pair").hidden) $("device-name").focus(); }, {once: true});
}
addEventListener("link-open", look);
look();
