// Light or dark is set before anything is painted, so that nothing flashes.
const THEME = "platform_ctrl theme", system = matchMedia("(prefers-color-scheme: dark)");
window.pageTheme = {
  choice: localStorage.getItem(THEME) ?? "system",
  get isDark() { return this.choice === "dark" || (this.choice === "system" && system.matches); },
  apply() { document.documentElement.dataset.theme = this.isDark ? "dark" : "light"; },
  choose(theme) {
    this.choice = theme;
    localStorage.setItem(THEME, theme);
    this.apply();
  },
};
window.pageTheme.apply();
