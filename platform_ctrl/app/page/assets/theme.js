// Before anything is painted: light or dark, so that nothing flashes.
window.pageTheme = (() => {
  "use strict";
  const KEY = "platform_ctrl theme", system = window.matchMedia("(prefers-color-scheme: dark)");
  const listeners = [];
  let kept = "system";
  try { kept = localStorage.getItem(KEY) || "system"; } catch { /* no storage: the system's theme */ }
  if (!["light", "dark", "system"].includes(kept)) kept = "system";
  const isDark = () => kept === "dark" || (kept === "system" && system.matches);
  const apply = () => {
    document.documentElement.dataset.theme = isDark() ? "dark" : "light";
    for (const tell of listeners) tell();
  };
  system.addEventListener("change", apply);
  apply();
  return {
    isDark,
    choice: () => kept,
    choose(theme) {
      kept = theme;
      try { localStorage.setItem(KEY, theme); } catch { /* it lasts as long as the page */ }
      apply();
    },
    onChange: (tell) => listeners.push(tell),
  };
})();
