// Drive: a thumb stick. Its command is sent only together with the answers that prove this device (attend.js).
import {send} from "/link.js";
import {alive} from "/alive.js";

const $ = (id) => document.getElementById(id);
const GAP_MS = 300; // without a question from the robot for this long, the command ends and the person must hold the stick again
const STEP = 0.01;
const KEYS = {ArrowUp: [1, 0], ArrowDown: [-1, 0], ArrowLeft: [0, 1], ArrowRight: [0, -1]};
const stick = $("stick"), knob = $("knob"), pressed = new Set();
let wanted = null, asked = -Infinity, may = false, needed = false, enabled = false, mode = "";

function draw() {
  const [forward, turn] = wanted || [0, 0];
  knob.style.transform = `translate(${-turn * 50}%, ${-forward * 50}%)`;
  stick.classList.toggle("held", !!wanted);
}

function set(forward, turn) {
  const within = (value) => Math.max(-1, Math.min(1, Math.round(value / STEP) * STEP));
  if (!wanted) asked = performance.now();
  wanted = [within(forward), within(turn)];
  draw();
}

function release(why) {
  pressed.clear();
  if (!wanted) return;
  wanted = null;
  send({drive: false});
  draw();
  if (typeof why === "string") $("drive-why").textContent = why;
}

// The command to send with the answer to the robot's question. Empty if there is none.
export function command() {
  const now = performance.now(), gap = now - asked;
  asked = now;
  if (gap > GAP_MS) release("The connection was too slow. Let go of the stick, then hold it again.");
  if (!alive()) release("The browser hung for half a second. Let go of the stick, then hold it again.");
  return wanted && !document.hidden ? wanted.map((value) => value.toFixed(2)).join(" ") : "";
}

// If the stick can have no effect, it sends nothing, so say what must be done first.
function ready() {
  let first = "";
  if ($("attend").getAttribute("aria-pressed") !== "true") first = "press ATTEND first";
  else if ($("limit").dataset.chosen === "false") first = "choose the speed limit first";
  else if (!enabled) first = "motion is disabled. Enable it, then hold the stick";
  $("drive-why").textContent = first && `Not now: ${first}.`;
  return !first;
}

function follow({clientX, clientY}) {
  const {left, top, width, height} = stick.getBoundingClientRect();
  set(1 - 2 * (clientY - top) / height, 1 - 2 * (clientX - left) / width);
}

stick.addEventListener("pointerdown", (event) => {
  if (!event.isPrimary || event.button) return;
  stick.setPointerCapture(event.pointerId);
  mode = "finger";
  if (ready()) follow(event);
});
stick.addEventListener("pointermove", (event) => { if (wanted && mode === "finger") follow(event); });
for (const end of ["pointerup", "pointercancel", "lostpointercapture", "blur"]) stick.addEventListener(end, release);
stick.addEventListener("contextmenu", (event) => event.preventDefault());
function press(event, down) {
  if (!(event.key in KEYS)) return;
  event.preventDefault();
  if (event.repeat || (down && !ready())) return;
  if (down) { pressed.add(event.key); mode = "keys"; } else pressed.delete(event.key);
  if (!pressed.size) { release(); return; }
  if (down || wanted) set(...[0, 1].map((axis) => [...pressed].reduce((sum, key) => sum + KEYS[key][axis], 0)));
}
stick.addEventListener("keydown", (event) => press(event, true));
stick.addEventListener("keyup", (event) => press(event, false));
for (const end of ["visibilitychange", "pagehide", "link-lost", "stopping"]) addEventListener(end, () => release());
addEventListener("lease", ({detail}) => { if (detail.drive) release(`Not now: ${detail.drive}.`); });
function show() { $("drive").hidden = !(may && needed); }
addEventListener("view", ({detail}) => {
  needed = detail.attended !== null;
  if (detail.enabled && !enabled) $("drive-why").textContent = ""; // what had to be done is done
  enabled = detail.enabled;
  if (!enabled) release("Motion is disabled now. Enable it, then hold the stick again.");
  show();
});
addEventListener("device", ({detail}) => { may = !!detail.device && !!detail.drive; if (!may) release(); show(); });
