// A length between two points that are clicked; a known one says how many metres a unit of the scene has.
import { byId, copy } from "./dom";
import type { State } from "./state";
import { lengthOf } from "./things";

export class Ruler {
  private readonly button = byId("measure");
  private readonly known = byId<HTMLInputElement>("known-length");
  private readonly option = byId("metres-per-unit");

  constructor(private readonly state: State) {
    this.button.addEventListener("click", () => this.toggle());
    this.known.addEventListener("input", () => {
      const unit = Number(this.known.value.replace(",", ".")) / lengthOf(state.measured!);
      state.set({ metresPerUnit: unit > 0 && unit < Infinity ? Number(unit.toPrecision(4)) : null });
    });
    this.option.addEventListener("click", () => void copy(this.option.textContent!.replace("Copy ", "")));
  }

  toggle(): void {
    byId("marker").hidden = true;
    this.state.set({ measured: this.state.measured ? null : [] });
  }

  /** Take a point of the scene; a third one begins another length. */
  add(point: number[]): void {
    const { measured } = this.state;
    if (!measured) return; // ended meanwhile
    this.known.value = "";
    this.state.set({ measured: measured.length === 1 ? [...measured, point] : [point] });
  }

  update(): void {
    const { measured, metresPerUnit } = this.state;
    this.button.setAttribute("aria-pressed", String(measured !== null));
    byId("ruler").hidden = !measured;
    const isWhole = measured?.length === 2;
    byId("measured").textContent = isWhole ? `Length ${this.state.lengths(lengthOf(measured))}` : `Click the ${measured?.length ? "second" : "first"} point.`;
    byId("scale").hidden = !isWhole;
    this.option.hidden = metresPerUnit === null;
    this.option.textContent = `Copy --metres-per-unit ${metresPerUnit}`;
  }
}
