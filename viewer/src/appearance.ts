// Dark or light, and the panel of narrow screens.
import { byId } from "./dom";

export function prepareAppearance(): void {
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  let chosen: string | null = null;
  const apply = () => {
    document.documentElement.dataset.theme = chosen ?? (dark.matches ? "dark" : "light");
  };
  dark.addEventListener("change", apply);
  byId("theme").addEventListener("click", () => {
    chosen = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
    apply();
  });
  apply();
  const collapse = byId("collapse");
  collapse.addEventListener("click", () => {
    const collapsed = byId("panel").classList.toggle("collapsed");
    collapse.setAttribute("aria-expanded", String(!collapsed));
  });
}

/** Whether the visitor has nothing against movement that they did not make. */
export function mayAnimate(): boolean {
  return !window.matchMedia("(prefers-reduced-motion: reduce)").matches;
}
