// Attend: this device proves, ten times a second, that it is awake, unlocked, shows this page, and that its browser answers.
import {reconnect, send} from "/link.js";
import {kept, sign} from "/keys.js";
import {command} from "/drive.js";
import {TOO_OLD, alive, watch} from "/alive.js";

const $ = (id) => document.getElementById(id);
let key = null, attends = false, paired = false, needed = false, known = true;

function show(why) {
  $("attendance").hidden = !(needed && paired && known);
  $("attend").setAttribute("aria-pressed", attends);
  $("attend").textContent = attends ? "ATTENDING - tap to leave" : "ATTEND";
  if (why !== undefined) $("attend-why").textContent = why;
}

function attend(on) {
  attends = on;
  watch(on);
}

function leave(why) {
  if (attends) send({attend: false});
  attend(false);
  show(why);
}

async function begin() {
  key = await kept().catch(() => null);
  if (!key) { show("This device has no key: it has to be paired over HTTPS."); return; }
  if (TOO_OLD) { show(TOO_OLD); return; }
  attend(true);
  send({attend: true});
  show("The robot stops when this page is hidden, the phone is locked, or the network is gone.");
}

$("attend").addEventListener("click", () => (attends ? leave("Nobody attends by this device.") : begin()));
addEventListener("lease", async ({detail}) => {
  if (detail.attend) { attend(false); show(detail.attend); return; }
  if (!detail.nonce || !attends || document.hidden) return;
  let drive = command();
  if (!alive()) return;
  let answer = await sign(key, detail.nonce + drive);
  if (drive && !command()) answer = await sign(key, detail.nonce + (drive = "")); // let go meanwhile
  send({nonce: detail.nonce, answer, drive});
});
addEventListener("visibilitychange", () => { if (document.hidden) leave("The page was hidden: attending has ended."); });
addEventListener("pagehide", () => leave("The page was left."));
addEventListener("link-lost", () => { if (attends) leave("The link was lost: attending has ended."); });
// The robot knows a connection by what it was when it began.
addEventListener("paired", () => { known = false; reconnect(); });
addEventListener("link-open", () => { known = true; show(); });
addEventListener("device", ({detail}) => { paired = !!detail.device; if (!paired) leave(""); show(); });
addEventListener("view", ({detail}) => {
  needed = detail.attended !== null;
  if (attends || !needed) show();
  else show(detail.attended.length ? `Attended by ${detail.attended.join(", ")}.` : "Nobody attends.");
});
