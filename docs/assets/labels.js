// Names for screen readers that the theme leaves out.
const named = () => {
  document.querySelectorAll(".md-search[role=dialog]").forEach((one) => one.setAttribute("aria-label", "Search"));
  document.querySelectorAll("nav.md-nav[aria-labelledby]").forEach((one) => {
    const label = document.getElementById(one.getAttribute("aria-labelledby"));
    one.setAttribute("aria-label", `Pages: ${label?.textContent.trim() || one.getAttribute("data-md-level")}`);
    one.removeAttribute("aria-labelledby");
  });
  document.querySelectorAll("nav.md-code__nav:not([aria-label])").forEach((one, k) => one.setAttribute("aria-label", `Code ${k + 1}`));
};
addEventListener("DOMContentLoaded", () => {
  named();
  new MutationObserver(named).observe(document.body, { childList: true, subtree: true });
});
