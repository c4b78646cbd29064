// Light or dark: as the system or as chosen.

const NAMES = ["auto", "light", "dark"];
const STORE = "retrograph-theme";

function chosen() {
  try {
    const name = localStorage.getItem(STORE);
    return NAMES.includes(name) ? name : "auto";
  } catch {
    return "auto";
  }
}

function apply(name, button) {
  document.documentElement.dataset.theme = name;
  button.textContent = `Theme: ${name}`;
  document.dispatchEvent(new Event("themechange"));
}

export function setUpTheme(button) {
  apply(chosen(), button);
  button.addEventListener("click", () => {
    const next = NAMES[(NAMES.indexOf(document.documentElement.dataset.theme) + 1) % NAMES.length];
    try {
      localStorage.setItem(STORE, next);
    } catch {
      // without storage, only the choice is lost
    }
    apply(next, button);
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () =>
    document.dispatchEvent(new Event("themechange")),
  );
}

/** A colour of the style sheet as [r, g, b], 0 to 1. */
export function styleColour(name) {
  const words = getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  return [1, 3, 5].map((at) => parseInt(words.slice(at, at + 2), 16) / 255);
}
