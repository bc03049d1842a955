// Which things a phrase or expression singles out, as src/scoup/query/ask.py and relations.py decide it.
import { leavesOf, textsOf, type Node, type Phrase, type Target } from "./phrases";
import type { Tensor, TensorData } from "./safetensors";
import { NO_OWNER } from "./scene_data";

/** Numbers of things, and the text that each answers, or its name. */
type Found = Map<number, string>;
export type Rules = Record<"CLEAR" | "OVER_PART" | "CONTACT" | "NEAR", number> & { BETWEEN: number[] };

/** Which sets of Gaussians answer, 1 or 0, with the things that may, and those under “not”. */
type Selected = [mask: Uint8Array, things: Found, excluded: Found];
/** Along right, up and away. */
type Shape = Record<"low" | "high" | "middle" | "extent", number[]>;

/** Axis and sign of relations and of the sides that orders count from. */
const BEYOND: Record<string, [number, number]> = { "left of": [0, -1], "right of": [0, 1], "in front of": [2, -1], behind: [2, 1] };
const ENDS: Record<string, [number, number]> = { left: [0, 1], right: [0, -1], top: [1, -1], bottom: [1, 1], front: [2, 1], back: [2, -1] };
const AXES = [0, 1, 2];

/** Whether the things of a phrase depend on where it is seen from. */
export const isSeen = ({ relation, order }: Phrase): boolean => relation in BEYOND || (order in ENDS && ENDS[order][0] !== 1);

const both = (one: Found, other: Found): Found => new Map([...one, ...other, ...one]); // the texts of the first
const minus = (one: number[], other: number[]): number[] => one.map((value, axis) => value - other[axis]);
const overlap = (one: Shape, other: Shape, axis: number): number => Math.min(one.high[axis], other.high[axis]) - Math.max(one.low[axis], other.low[axis]);
const gap = (one: Shape, other: Shape): number => Math.hypot(...AXES.map((axis) => Math.max(0, -overlap(one, other, axis))));
/** The share of one thing's footprint that lies over another's. */
const cover = (one: Shape, other: Shape): number =>
  [0, 2].reduce((share, axis) => (share * Math.max(0, overlap(one, other, axis))) / Math.max(one.extent[axis], 1e-30), 1);

/** The things of a scene as `scoup.query.phrase_data` describes them. */
export class Relations {
  /** Of each thing, the sets of Gaussians with the same owners that it consists of, and its shape. */
  private readonly members: number[][];
  private readonly shapes: Shape[];
  private readonly counts: TensorData;
  private readonly objects: Found;

  constructor(
    private readonly tensors: Map<string, Tensor>,
    private readonly rules: Rules,
    names: Map<number, string>,
  ) {
    this.objects = new Map(Array.from(this.numbers("objects"), (thing) => [thing, names.get(thing) ?? ""]));
    this.counts = this.numbers("owner_counts");
    this.members = Array.from(this.numbers("parents"), () => []);
    this.numbers("owner_sets").forEach((owner: number, at: number) => {
      if (owner !== NO_OWNER) this.members[owner].push(at % this.counts.length);
    });
    const spans = this.numbers("thing_spans");
    this.shapes = this.members.map((_, thing) => {
      const [low, high] = [0, 1].map((end) => AXES.map((axis) => spans[6 * thing + 2 * axis + end]));
      return { low, high, middle: low.map((value, axis) => (value + high[axis]) / 2), extent: minus(high, low) };
    });
  }

  /**
   * The things that answer, things whose Gaussians do not, and how many Gaussians do.
   *
   * @param words - the things that answer each text
   * @param partOf - the part of a thing that fits a text best; null if things of other levels do not answer
   */
  evaluate(root: Node, words: Map<string, number[]>, partOf: ((text: string, thing: number) => number) | null) {
    const things = new Map([["", this.objects], ...[...words].map(([text, numbers]) => [text, new Map(numbers.map((number) => [number, text]))] as const)]);
    const [mask, may, excluded] = this.select(root, (leaf) => this.resolve(leaf, partOf ? this.apart(leaf, things, partOf) : things));
    const found = new Map([...(leavesOf(root).some(([, sign]) => sign) ? may : this.objects)].filter(([thing]) => 2 * this.count(thing, mask) > this.count(thing)));
    const without = [...excluded.keys()].filter((thing) => !found.has(thing)).sort((a, b) => a - b);
    return { found, without, gaussians: mask.reduce((sum, bit, set) => sum + bit * this.counts[set], 0) };
  }

  private numbers(name: string): TensorData {
    return this.tensors.get(name)!.data;
  }

  /** Gaussians of a thing, or those of them in a mask. */
  private count(thing: number, mask?: Uint8Array): number {
    return this.members[thing].reduce((sum, set) => sum + (mask ? mask[set] : 1) * this.counts[set], 0);
  }

  private maskOf(things: Iterable<number>): Uint8Array {
    const mask = new Uint8Array(this.counts.length);
    for (const thing of things) for (const set of this.members[thing]) mask[set] = 1;
    return mask;
  }

  private select(node: Node, resolve: (leaf: Target) => Found): Selected {
    if (typeof node === "string" || !("operator" in node)) {
      const things = resolve(node);
      return [this.maskOf(things.keys()), things, new Map()];
    }
    const [[mask, things, excluded], other] = node.parts.map((part) => this.select(part, resolve));
    if (node.operator === "not") return [mask.map((bit) => 1 - bit), excluded, things];
    return [mask.map((bit, set) => (node.operator === "and" ? bit & other[0][set] : bit | other[0][set])), both(things, other[1]), both(excluded, other[2])];
  }

  /** The things of each text; where one contains a thing of another text of a phrase, the parts that fit better instead. */
  private apart(leaf: Target, things: Map<string, Found>, partOf: (text: string, thing: number) => number): Map<string, Found> {
    const apart = new Map(things);
    const texts = [...new Set(textsOf(leaf))];
    const each = (text: string) => [...things.get(text)!.keys()].map((thing): [string, number] => [text, thing]);
    const pairs = texts.flatMap((text, at) => texts.slice(at + 1).flatMap((next) => each(text).flatMap((one) => each(next).map((other) => [one, other]))));
    for (const pair of pairs) {
      const [[, one], [, other]] = pair;
      const parts = pair.map(([text, thing]) => partOf(text, thing));
      if (!(this.isPart(one, other) || this.isPart(other, one)) || this.overlaps(parts[0], parts[1])) continue;
      pair.forEach(([text, whole], at) =>
        apart.set(text, new Map([...apart.get(text)!].map(([thing, said]) => [thing === whole ? parts[at] : thing, said]))));
    }
    return apart;
  }

  private isPart(thing: number, whole: number): boolean {
    return thing === whole || (thing !== NO_OWNER && this.isPart(this.numbers("parents")[thing], whole));
  }

  /** Whether one is most of the other, or a part of it. */
  private overlaps(one: number, other: number): boolean {
    return this.count(one, this.maskOf([other])) > 0.5 * Math.min(this.count(one), this.count(other));
  }

  private resolve(target: Target, things: Map<string, Found>): Found {
    if (typeof target === "string") return things.get(target)!;
    const anchors = target.anchors.map((anchor) => [...this.resolve(anchor, things).keys()]);
    const all = things.get(target.text)!;
    const own = [...all.keys()].filter((thing) => target.text || !anchors.flat().some((other) => this.overlaps(thing, other)));
    const found = this.ordered(target, target.relation ? this.related(target.relation, own, anchors) : own);
    return new Map(found.map((thing) => [thing, all.get(thing)!]));
  }

  private related(relation: string, things: number[], [first, second = [-1]]: number[][]): number[] {
    const pairs = first.flatMap((other) => second.map((end) => [other, end]));
    if (relation !== "nearest to") {
      return things.filter((one) => pairs.some(([other, end]) => one !== other && one !== end && other !== end && this.holds(relation, one, other, end)));
    }
    const distances = things.flatMap((thing, at) => first.filter((other) => other !== thing).map((other) => {
      const [one, anchor] = [this.shapes[thing], this.shapes[other]];
      return [gap(one, anchor), Math.hypot(...minus(one.middle, anchor.middle)), at];
    }));
    return distances.sort((a, b) => a[0] - b[0] || a[1] - b[1] || a[2] - b[2]).slice(0, 1).map(([, , at]) => things[at]);
  }

  private holds(relation: string, thing: number, anchor: number, last = -1): boolean {
    const [one, other, end] = [thing, anchor, last].map((number) => this.shapes[number]);
    const { rules } = this;
    const [axis, sign] = BEYOND[relation] ?? [-1, 0];
    if (sign) return sign * (one.middle[axis] - other.middle[axis]) > rules.CLEAR * 0.5 * other.extent[axis];
    if (relation === "near") return gap(one, other) <= rules.NEAR * Math.max(Math.hypot(...one.extent), Math.hypot(...other.extent));
    if (relation === "under") return this.holds("above", anchor, thing);
    if (relation === "above") {
      const isClear = one.low[1] >= other.high[1] - rules.CONTACT * one.extent[1] && !this.holds("on", anchor, thing);
      return Math.max(cover(one, other), cover(other, one)) >= rules.OVER_PART && (isClear || this.holds("on", thing, anchor));
    }
    if (relation === "between") {
      const [line, offset] = [end, one].map(({ middle }) => minus(middle, other.middle));
      const length = Math.hypot(...line);
      const along = line.reduce((sum, value, axis) => sum + value * offset[axis], 0) / length ** 2;
      const [from, to, aside] = rules.BETWEEN;
      return from <= along && along <= to && Math.hypot(...minus(offset, line.map((value) => along * value))) <= aside * length;
    }
    const pairs = this.numbers(relation);
    return pairs.some((number: number, at: number) => at % 2 === 0 && number === thing && pairs[at + 1] === anchor);
  }

  /** The one thing of an order and rank; all without an order. */
  private ordered({ order, rank }: Phrase, things: number[]): number[] {
    const [axis, sign] = ENDS[order] ?? [-1, order === "largest" ? -1 : 1];
    const key = (thing: number) => sign * (axis < 0 ? this.numbers("thing_sizes")[thing] : this.shapes[thing].middle[axis]);
    return order ? [...things].sort((a, b) => key(a) - key(b)).slice(rank - 1, rank) : things;
  }
}
