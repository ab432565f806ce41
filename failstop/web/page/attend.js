// Attend: ten times a second, this device proves that it is awake and unlocked, shows this page, and has a browser that answers.
import {reconnect, send} from "/link.js";
import {kept, sign} from "/keys.js";
import {command} from "/drive.js";
import {TOO_OLD, alive, watch} from "/alive.js";

const $ = (id) => document.getElementById(id);
const UNCOUNTED_MS = 1000; // after this long, the page says that the robot does not count this device
const CHECK_MS = 200;
const HINT = "The robot stops if you hide this page, lock the phone or lose the network.";
const UNCOUNTED = "The robot does not count you: this page's answers reach it too late, or not at all. The network may be too slow.";
let key = null, attends = false, paired = false, needed = false, known = true, missed = false;
let refused = ""; // why the last tap did nothing; shown until the connection is back or somebody attends
let counted = -Infinity; // when the robot last said in time that it counts this device

function show(why) {
  $("attendance").hidden = !(needed && paired && known);
  $("attend").setAttribute("aria-pressed", attends);
  $("attend").textContent = attends ? `${missed ? "NOT COUNTED" : "ATTENDING"} - tap to leave` : "ATTEND";
  if (why !== undefined) $("attend-why").textContent = why;
}

function attend(on) {
  attends = on;
  refused = "";
  missed = false;
  counted = performance.now();
  watch(on);
}

function leave(why) {
  if (attends) send({attend: false});
  attend(false);
  show(why);
}

async function begin() {
  key = await kept().catch(() => null);
  if (!key) { show("This device has no key, so pair it again over HTTPS."); return; }
  if (TOO_OLD) { show(TOO_OLD); return; }
  if (!send({attend: true})) { show(refused = "Not now: there is no connection to the robot. Try again."); return; }
  attend(true);
  show(HINT);
}

function check() {
  const misses = attends && performance.now() - counted > UNCOUNTED_MS;
  if (misses === missed) return;
  missed = misses;
  show(missed ? UNCOUNTED : attends ? HINT : undefined);
}

$("attend").addEventListener("click", () => (attends ? leave("You stopped attending on this device.") : begin()));
addEventListener("lease", async ({detail}) => {
  if (detail.attend) { attend(false); show(detail.attend); return; }
  if (detail.counted && !detail.late) counted = performance.now();
  if (!detail.nonce || !attends || document.hidden) return;
  let drive = command();
  if (!alive()) return;
  let answer = await sign(key, detail.nonce + drive);
  if (drive && !command()) answer = await sign(key, detail.nonce + (drive = "")); // the stick was let go meanwhile
  send({nonce: detail.nonce, answer, drive});
});
addEventListener("visibilitychange", () => { if (document.hidden) leave("You stopped attending, because the page was hidden."); });
addEventListener("pagehide", () => leave("You stopped attending, because you left the page."));
addEventListener("link-lost", () => { if (attends) leave("You stopped attending, because the connection was lost."); });
// The robot looks at the pairing only when a connection begins, so connect again after pairing.
addEventListener("paired", () => { known = false; reconnect(); });
addEventListener("link-open", () => { known = true; attend(false); show(); }); // a new connection attends only when asked
addEventListener("device", ({detail}) => { paired = !!detail.device; if (!paired) leave(""); show(); });
addEventListener("view", ({detail}) => {
  needed = detail.attended !== null;
  if (attends || !needed) show();
  else show(refused || (detail.attended.length ? `Attended by ${detail.attended.join(", ")}.` : "Nobody attends."));
});
setInterval(check, CHECK_MS);
