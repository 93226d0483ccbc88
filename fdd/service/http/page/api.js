// Talking to the service: requests, and events as they come.

export class Refused extends Error {
  constructor(status, text) { super(text); this.status = status; }
}

async function ask(path, options) {
  let response;
  try {
    response = await fetch(path, { credentials: "same-origin", signal: AbortSignal.timeout(15000), ...options });
  } catch {
    throw new Refused(0, "The service does not answer.");
  }
  const body = await response.json().catch(() => ({}));
  if (!response.ok) throw new Refused(response.status, body.error ?? `The service answered ${response.status}.`);
  return body;
}

export const get = (path) => ask(path);
export const remove = (path) => ask(path, { method: "DELETE", headers: { "x-fdd": "1" } });
export const post = (path, body = {}) =>
  ask(path, { method: "POST", body: JSON.stringify(body), headers: { "content-type": "application/json", "x-fdd": "1" } });

// `told` is given each event, `state` whether the line stands. The browser connects anew by itself, but not
// after a refusal.
export function listen(told, state) {
  const source = new EventSource("/api/events");
  source.onopen = () => state(true);
  source.onerror = () => {
    state(false);
    if (source.readyState === EventSource.CLOSED) setTimeout(() => listen(told, state), 5000);
  };
  source.onmessage = (event) => told(JSON.parse(event.data));
  source.addEventListener("reset", () => told({ kind: "reset" }));
}
