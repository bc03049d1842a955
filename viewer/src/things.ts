// The things of a scene: which are selected, hidden and named, and what a click selects.
import type { Place } from "./answers";
import { announce } from "./dom";
import type { Painted } from "./picking";
import { NO_OWNER, type Scene, type Thing } from "./scene_data";

/** A thing counts as under the pointer if it contributes this share of the ray. */
const LEAST_SHARE = 0.2;

export class Things {
  selected: number[] = [];
  hovered: number | null = null;
  readonly hidden = new Set<number>();
  /** Counts the changes of names. */
  revision = 0;
  onChange: () => void = () => {};
  onHover: () => void = () => {};
  private readonly names: Map<number, string>;
  private readonly byNumber: Map<number, Thing>;

  /** @param session key of the names that the visitor chose, in the storage of the browser's session */
  constructor(
    readonly all: readonly Thing[],
    private readonly session: string,
  ) {
    this.names = new Map(storedNames(session));
    this.byNumber = new Map(all.map((thing) => [thing.number, thing]));
  }

  of(number: number): Thing {
    return this.byNumber.get(number)!;
  }

  nameOf(number: number): string {
    return this.names.get(number) ?? this.byNumber.get(number)?.name ?? `thing ${number}`;
  }

  /** Name a thing; an empty name takes the name back. */
  rename(number: number, name: string): void {
    if (name.trim()) this.names.set(number, name.trim());
    else this.names.delete(number);
    this.revision += 1;
    try {
      sessionStorage.setItem(this.session, JSON.stringify([...this.names]));
    } catch {
      // Without a storage, names last as long as the page.
    }
    this.onChange();
  }

  /** Things whose name or number contains a text. */
  matching(text: string): Thing[] {
    const wanted = text.trim().toLowerCase();
    return this.all.filter(({ number }) => `${this.nameOf(number)} ${number}`.toLowerCase().includes(wanted));
  }

  select(numbers: number[]): void {
    this.selected = numbers;
    announce("selected", { things: numbers.map((number) => ({ ...this.of(number), name: this.nameOf(number) })) });
    this.onChange();
  }

  /** Add a thing to what is selected, or take it away. */
  toggle(number: number): void {
    const others = this.selected.filter((each) => each !== number);
    this.select(others.length < this.selected.length ? others : [...others, number]);
  }

  hover(number: number | null): void {
    if (number === this.hovered) return;
    this.hovered = number;
    this.onHover();
  }

  /** Hide what is selected. */
  hide(): void {
    for (const number of this.selected) this.hidden.add(number);
    this.hover(null);
    this.select([]);
  }

  showAll(): void {
    this.hidden.clear();
    this.onChange();
  }

  /** Select what a click on a thing means: the thing; its group where it is selected already; its part under the pointer. */
  click(scene: Scene, painted: Painted[], level: number, { adds, part }: { adds: boolean; part: boolean }): void {
    const under = this.under(scene, painted, level);
    if (under === null) {
      if (!adds) this.select([]);
      return;
    }
    if (adds) return this.toggle(under);
    const last = this.selected.length === 1 && this.lineOf(under).includes(this.selected[0]) ? this.selected[0] : null;
    if (part) {
      const whole = last ?? under;
      const child = strongest(scene, painted, this.of(whole).level - 1, (number) => this.byNumber.get(number)?.parent === whole);
      return this.select([child ?? whole]);
    }
    this.select([last === null ? under : (this.parentOf(last) ?? last)]);
  }

  /** The thing under the pointer at a level, or, where there is none, at the nearest coarser or finer one. */
  under(scene: Scene, painted: Painted[], level: number): number | null {
    const levels = Array.from({ length: scene.levels }, (_, each) => each);
    const order = [...levels.slice(level), ...levels.slice(0, level).reverse()];
    for (const each of order) {
      const found = strongest(scene, painted, each, (number) => this.byNumber.has(number));
      if (found !== null) return found;
    }
    return null;
  }

  /** Names of the things along a ray, level by level, what contributes most first. */
  along(scene: Scene, painted: Painted[]): Place["levels"] {
    return scene.metadata.levels.map((level, s) => {
      const sure = painted.reduce((sum, { gaussian, weight }) => sum + weight * scene.confidence(gaussian, s), 0);
      const coded = painted.reduce((sum, { gaussian, weight }) => sum + (scene.confidence(gaussian, s) ? weight : 0), 0);
      const things = shares(scene, painted, s, (number) => this.byNumber.has(number));
      return { level, confidence: coded && sure / coded, words: things.map(([number]) => ({ text: this.nameOf(number), relevancy: null })) };
    });
  }

  /** Whether a Gaussian is of a hidden thing. */
  hides(scene: Scene, gaussian: number): boolean {
    if (!this.hidden.size) return false;
    for (let level = 0; level < scene.levels; level++) {
      if (this.hidden.has(scene.owner(gaussian, level))) return true;
    }
    return false;
  }

  /** Distance of the centres of the two things that are selected. */
  distance(): number | null {
    if (this.selected.length !== 2) return null;
    return lengthOf(this.selected.map((number) => this.of(number).position));
  }

  /** A thing, its group, the group of that. */
  private lineOf(number: number): number[] {
    const line = [number];
    for (let parent = this.parentOf(number); parent !== null && !line.includes(parent); parent = this.parentOf(parent)) {
      line.push(parent);
    }
    return line;
  }

  /** Its group, unless that is too small to be listed. */
  private parentOf(number: number): number | null {
    const { parent } = this.of(number);
    return parent !== null && this.byNumber.has(parent) ? parent : null;
  }
}

/** The thing of a level that contributes most along a ray, among those that may. */
function strongest(scene: Scene, painted: Painted[], level: number, may: (number: number) => boolean): number | null {
  return shares(scene, painted, level, may)[0]?.[0] ?? null;
}

/** Things of a level with what they contribute along a ray, most first: those that may, and contribute enough. */
function shares(scene: Scene, painted: Painted[], level: number, may: (number: number) => boolean): [number, number][] {
  const weights = new Map<number, number>();
  let total = 0;
  for (const { gaussian, weight } of painted) {
    total += weight;
    const owner = level < 0 ? NO_OWNER : scene.owner(gaussian, level);
    if (owner !== NO_OWNER && may(owner)) weights.set(owner, (weights.get(owner) ?? 0) + weight);
  }
  return [...weights].filter(([, weight]) => weight >= LEAST_SHARE * total).sort((a, b) => b[1] - a[1]);
}

function storedNames(session: string): [number, string][] {
  try {
    return JSON.parse(sessionStorage.getItem(session) ?? "[]") as [number, string][];
  } catch {
    return [];
  }
}

/** The distance of two points. */
export function lengthOf([from, to]: number[][]): number {
  return Math.hypot(...from.map((part, axis) => part - to[axis]));
}
