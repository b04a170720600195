// Requests to the server besides the live feed, and messages about their results.

const csrf = document.querySelector('meta[name="csrf"]');

export async function call(path, body) {
  const options = body === undefined ? {} : {
    method: "POST",
    headers: { "content-type": "application/json", "x-hubodo-token": csrf.content },
    body: JSON.stringify(body),
  };
  const answer = await fetch(path, options);
  if (!answer.ok) {
    const text = await answer.text();
    let message = text.trim();
    try { message = JSON.parse(text).error; } catch { /* plain text */ }
    throw new Error(message || `the server answers with status ${answer.status}`);
  }
  return answer.json();
}

// Replaces the CSRF secret: a restarted recorder has a new one, while the page stays open.
export function replaceCsrfSecret(secret) {
  if (secret) { csrf.content = secret; }
}

export async function send(action, body) {
  try {
    await call(`/api/do/${action}`, body);
    return true;
  } catch (error) {
    toast(error.message);
    return false;
  }
}

// Ends the session, also on the server; the login page asks for the token again.
export async function logOut() {
  try {
    await call("/logout", {});
    location.assign("/login");
  } catch (error) {
    toast(error.message);
  }
}

let hideTimer = 0;
export function toast(text) {
  const box = document.getElementById("toast");
  box.textContent = text;
  box.hidden = false;
  clearTimeout(hideTimer);
  hideTimer = setTimeout(() => { box.hidden = true; }, 4000);
}
