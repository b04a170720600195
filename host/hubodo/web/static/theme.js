// Colour scheme: light, dark or system setting; the choice is stored in the browser.

const CHOICES = ["system", "light", "dark"];
const LABELS = { system: "system setting", light: "light", dark: "dark" };
const SYMBOLS = { system: "◐", light: "○", dark: "●" };
const dark = window.matchMedia("(prefers-color-scheme: dark)");

export function theme(button, onChange) {
  let choice = localStorage.getItem("theme") ?? "system";
  const apply = () => {
    document.documentElement.dataset.theme = choice === "system" ? (dark.matches ? "dark" : "light") : choice;
    button.textContent = SYMBOLS[choice];
    button.setAttribute("aria-label", `Colours: ${LABELS[choice]}`);
    onChange();
  };
  button.addEventListener("click", () => {
    choice = CHOICES[(CHOICES.indexOf(choice) + 1) % CHOICES.length];
    localStorage.setItem("theme", choice);
    apply();
  });
  dark.addEventListener("change", apply);
  apply();
}
