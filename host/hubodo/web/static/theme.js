// Light, dark, or as the system has it; what was chosen is kept.

const CHOICES = ["system", "light", "dark"];
const WORDS = { system: "as the system has them", light: "light", dark: "dark" };
const MARKS = { system: "◐", light: "○", dark: "●" };
const dark = window.matchMedia("(prefers-color-scheme: dark)");

export function theme(button, changed) {
  let chosen = localStorage.getItem("theme") ?? "system";
  const apply = () => {
    document.documentElement.dataset.theme = chosen === "system" ? (dark.matches ? "dark" : "light") : chosen;
    button.textContent = MARKS[chosen];
    button.setAttribute("aria-label", `Colours: ${WORDS[chosen]}`);
    changed();
  };
  button.addEventListener("click", () => {
    chosen = CHOICES[(CHOICES.indexOf(chosen) + 1) % CHOICES.length];
    localStorage.setItem("theme", chosen);
    apply();
  });
  dark.addEventListener("change", apply);
  apply();
}
