// What the page asks of the server besides the live feed, and how it tells what came of it.

const csrf = document.querySelector('meta[name="csrf"]');

export async function call(path, body) {
  const asked = body === undefined ? {} : {
    method: "POST",
    headers: { "content-type": "application/json", "x-hubodo-token": csrf.content },
    body: JSON.stringify(body),
  };
  const answer = await fetch(path, asked);
  if (!answer.ok) {
    const text = await answer.text();
    let words = text.trim();
    try { words = JSON.parse(text).error; } catch { /* plain words */ }
    throw new Error(words || `the server says ${answer.status}`);
  }
  return answer.json();
}

// A restarted recorder knows other secrets than the page that stayed open.
export function renew(fresh) {
  if (fresh) { csrf.content = fresh; }
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

// Ends the session on the server too; the page that follows asks for the token.
export async function logOut() {
  try {
    await call("/logout", {});
    location.assign("/login");
  } catch (error) {
    toast(error.message);
  }
}

let hiding = 0;
export function toast(text) {
  const place = document.getElementById("toast");
  place.textContent = text;
  place.hidden = false;
  clearTimeout(hiding);
  hiding = setTimeout(() => { place.hidden = true; }, 4000);
}
