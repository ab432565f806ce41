// Attend: ten times a second, this device proves that it is awake and unlocked, shows this page, and has a browser that answers.
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
  if (!key) { show("This device has no key, so pair it again over HTTPS."); return; }
  if (TOO_OLD) { show(TOO_OLD); return; }
  attend(true);
  send({attend: true});
  show("The robot stops if you hide this page, lock the phone or lose the network.");
}

$("attend").addEventListener("click", () => (attends ? leave("You stopped attending on this device.") : begin()));
addEventListener("lease", async ({detail}) => {
  if (detail.attend) { attend(false); show(detail.attend); return; }
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
addEventListener("link-open", () => { known = true; show(); });
addEventListener("device", ({detail}) => { paired = !!detail.device; if (!paired) leave(""); show(); });
addEventListener("view", ({detail}) => {
  needed = detail.attended !== null;
  if (attends || !needed) show();
  else show(detail.attended.length ? `Attended by ${detail.attended.join(", ")}.` : "Nobody attends.");
});
