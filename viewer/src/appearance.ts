// The panel of narrow screens, and movement.
import { byId } from "./dom";

export function prepareAppearance(): void {
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
