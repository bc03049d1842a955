// A length between two points that are clicked; a known one says how many metres a unit of the scene has.
import { quoted } from "./commands";
import { byId, copy } from "./dom";
import type { State } from "./state";
import { lengthOf } from "./things";

export class Ruler {
  private readonly button = byId("measure");
  private readonly known = byId<HTMLInputElement>("known-length");
  private readonly option = byId("metres-per-unit");
  private readonly knownBefore: number | null; // of the field

  constructor(private readonly state: State, private readonly field: string, private readonly say: (sentence: string) => void) {
    this.knownBefore = state.metresPerUnit;
    this.button.addEventListener("click", () => this.toggle());
    for (const event of ["input", "change"]) this.known.addEventListener(event, () => this.read(event === "change"));
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
    this.mark(false);
    this.state.set({ measured: measured.length === 1 ? [...measured, point] : [point] });
  }

  /** Take the true length that is typed; a bad one changes nothing, and is marked once it is whole. */
  private read(isWhole: boolean): void {
    const { measured } = this.state;
    if (measured?.length !== 2) return; // the field loses the focus as it is hidden
    const typed = this.known.value.trim().replace(",", ".");
    const unit = Number(typed) / lengthOf(measured);
    const isBad = typed !== "" && !(unit > 0 && unit < Infinity);
    this.mark(isBad && isWhole);
    if (!isBad) this.state.set({ metresPerUnit: typed ? Number(unit.toPrecision(4)) : this.knownBefore });
  }

  private mark(isBad: boolean): void {
    this.known.setAttribute("aria-invalid", String(isBad));
    this.say(isBad ? "The true length must be a number above 0, such as 0.6." : "");
  }

  update(): void {
    const { measured, metresPerUnit } = this.state;
    this.button.setAttribute("aria-pressed", String(measured !== null));
    byId("ruler").hidden = !measured;
    const isWhole = measured?.length === 2;
    byId("measured").textContent = isWhole ? `Length ${this.state.lengths(lengthOf(measured))}` : `Click the ${measured?.length ? "second" : "first"} point.`;
    byId("scale").hidden = !isWhole;
    this.option.hidden = metresPerUnit === this.knownBefore;
    this.option.textContent = `Copy scoup frame ${quoted(this.field)} --metres-per-unit ${metresPerUnit}`;
  }
}
