// Keys: stores the key that proves this device. Scripts can use the key, but can't read or copy it.
const STORE = "lease", PLACE = "failstop";

function opened() {
  return new Promise((done, failed) => {
    const asked = indexedDB.open(PLACE, 1);
    asked.onupgradeneeded = () => asked.result.createObjectStore(STORE);
    asked.onsuccess = () => done(asked.result);
    asked.onerror = () => failed(asked.error);
  });
}

async function does(mode, what) {
  const base = await opened();
  return new Promise((done, failed) => {
    const asked = what(base.transaction(STORE, mode).objectStore(STORE));
    asked.onsuccess = () => { done(asked.result); base.close(); };
    asked.onerror = () => { failed(asked.error); base.close(); };
  });
}

export async function keep(hex) {
  const bytes = Uint8Array.from(hex.match(/../g), (pair) => parseInt(pair, 16));
  const key = await crypto.subtle.importKey("raw", bytes, {name: "HMAC", hash: "SHA-256"}, false, ["sign"]);
  await does("readwrite", (store) => store.put(key, "key"));
}

export function kept() {
  return globalThis.crypto && crypto.subtle ? does("readonly", (store) => store.get("key")) : Promise.resolve(null);
}

export function forget() {
  return does("readwrite", (store) => store.delete("key"));
}

export async function sign(key, text) {
  const made = await crypto.subtle.sign("HMAC", key, new TextEncoder().encode(text));
  return Array.from(new Uint8Array(made), (byte) => byte.toString(16).padStart(2, "0")).join("");
}
