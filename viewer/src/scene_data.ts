// The scene as it comes from Python (src/scoup/view/scene_data.py).
import type { Packed, Tensor, TensorData } from "./safetensors";

export interface CameraRecord {
  name: string;
  viewmat: number[];
  K: number[];
  width: number;
  height: number;
}

export interface Metadata {
  version: number;
  name: string;
  n_gaussians: number;
  levels: string[];
  n_atoms: number;
  up: [number, number, number];
  /** Null while the field knows no metre. */
  metres_per_unit: number | null;
  centre: [number, number, number];
  radius: number;
  embedding_model: string;
  words_problem: string | null;
  present_from: number | null;
  /** Of a large scene, whose parts are loaded later: how many of these Gaussians stand for each part. */
  parts?: number[];
  /** If parts are merged: how many Gaussians whole parts may have together. */
  most?: number;
  /** Things of all levels; missing where the field has none. */
  n_things?: number;
  /** All of them, in an exported page. */
  things?: Thing[];
  cameras: CameraRecord[];
}

/** The facts of a thing, as Python has them (`LanguageField.things`); lengths in the units of the scene. */
export interface Thing {
  number: number;
  /** Position of its level, fine to coarse. */
  level: number;
  /** Number of the thing it is a part of. */
  parent: number | null;
  name: string | null;
  /** "detector" or "embedding", which is wrong more often; "" without a name. */
  named_by: string;
  position: number[];
  box: { centre: number[]; axes: number[][]; extent: number[] };
  gaussians: number;
  views: number;
}

/** The owner of a Gaussian that belongs to no thing. */
export const NO_OWNER = 65535;

interface Ranges {
  means_low: number[];
  means_high: number[];
  scales_low: number;
  scales_high: number;
  weights_scale: number;
}

/** Tensors of a scene whose last axis runs over Gaussians. */
const BY_GAUSSIAN = ["means", "scales", "quats", "colors", "opacities", "code_indices", "code_weights", "confidence", "owners"];

/** The Gaussians of a page with their codes; arrays run over components first, as they are packed. */
export class Scene {
  readonly metadata: Metadata & Ranges;
  readonly count: number;
  readonly levels: number;
  readonly atoms: number;
  /** Atoms of a code. */
  readonly k: number;
  /** Canonical phrases. */
  readonly phrases: number;
  private readonly tensors: Map<string, Tensor>;
  // Looked up once: these are read millions of times.
  private readonly numbers: Record<string, TensorData>;
  private readonly pieceOf: Uint16Array;
  private knownBalls: Float32Array | null = null;

  /** @param pieces of the Gaussians, each with ranges of its own: where each ends */
  constructor(packed: Packed, private readonly pieces: { end: number; ranges: Ranges }[] = []) {
    this.metadata = packed.metadata as Metadata & Ranges;
    if (this.metadata.version !== 1) throw new Error(`this page cannot read version ${this.metadata.version} of its scene`);
    this.tensors = packed.tensors;
    this.numbers = Object.fromEntries([...this.tensors].map(([name, { data }]) => [name, data]));
    this.count = this.numbers.opacities.length;
    const [levels, k] = this.tensor("code_indices").shape;
    [this.levels, this.k, this.atoms] = [levels, k, this.metadata.n_atoms];
    this.phrases = this.tensors.get("canonical")?.shape[1] ?? 0;
    this.pieceOf = new Uint16Array(pieces.length ? this.count : 0);
    pieces.forEach(({ end }, piece) => this.pieceOf.fill(piece, pieces[piece - 1]?.end ?? 0, end));
  }

  /** A part of the scene that came later. */
  part(packed: Packed): Scene {
    const { tensors, metadata } = packed;
    const own = { ...this.metadata, parts: undefined, ...(metadata as Ranges) };
    return new Scene({ tensors: new Map([...this.tensors, ...tensors]), metadata: own });
  }

  /** Its Gaussians part by part, as its metadata count them. */
  coarseParts(): Scene[] {
    let end = 0;
    return (this.metadata.parts ?? []).map((count) => {
      const tensors = new Map(this.tensors);
      for (const name of BY_GAUSSIAN) {
        const tensor = tensors.get(name);
        if (tensor) tensors.set(name, rowsOf(tensor, end, end + count));
      }
      end += count;
      return new Scene({ tensors, metadata: { ...this.metadata, parts: undefined } });
    });
  }

  /** One scene of all parts. */
  static joined(parts: Scene[]): Scene {
    const [first] = parts;
    const tensors = new Map(first.tensors);
    for (const name of BY_GAUSSIAN) {
      if (tensors.has(name)) tensors.set(name, joined(parts.map((part) => part.tensor(name))));
    }
    let end = 0;
    const pieces = parts.map(({ count, metadata }) => ({ end: (end += count), ranges: metadata }));
    return new Scene({ tensors, metadata: first.metadata }, pieces);
  }

  private ranges(i: number): Ranges {
    return this.pieces.length ? this.pieces[this.pieceOf[i]].ranges : this.metadata;
  }

  /** [N, 4]: position and largest standard deviation of each Gaussian, for what reads all of them at once. */
  get balls(): Float32Array {
    if (this.knownBalls) return this.knownBalls;
    const balls = (this.knownBalls = new Float32Array(4 * this.count));
    for (let i = 0; i < this.count; i++) {
      for (let axis = 0; axis < 3; axis++) {
        balls[4 * i + axis] = this.coordinate(i, axis);
        balls[4 * i + 3] = Math.max(balls[4 * i + 3], this.scale(i, axis));
      }
    }
    return balls;
  }

  tensor(name: string): Tensor {
    const found = this.tensors.get(name);
    if (!found) throw new Error(`the scene lacks ${name}`);
    return found;
  }

  /** Position of a Gaussian into `out`. */
  mean(i: number, out: { x: number; y: number; z: number }): void {
    out.x = this.coordinate(i, 0);
    out.y = this.coordinate(i, 1);
    out.z = this.coordinate(i, 2);
  }

  private coordinate(i: number, axis: number): number {
    const { count, numbers: { means } } = this;
    const value = means[axis * count + i] * 65536 + means[(3 + axis) * count + i] * 256 + means[(6 + axis) * count + i];
    const { means_low: low, means_high: high } = this.ranges(i);
    return low[axis] + (value / 16777215) * (high[axis] - low[axis]);
  }

  /** Standard deviation along an axis of a Gaussian's own frame. */
  scale(i: number, axis: number): number {
    const { scales_low: low, scales_high: high } = this.ranges(i);
    return Math.exp(low + (this.numbers.scales[axis * this.count + i] / 255) * (high - low));
  }

  /** Rotation w, x, y, z of norm 1. */
  quat(i: number): [number, number, number, number] {
    const { count, numbers: { quats } } = this;
    const [w, x, y, z] = [quats[i], quats[count + i], quats[2 * count + i], quats[3 * count + i]];
    const norm = Math.sqrt(w * w + x * x + y * y + z * z) || 1;
    return [w / norm, x / norm, y / norm, z / norm];
  }

  opacity(i: number): number {
    return this.numbers.opacities[i] / 255;
  }

  color(i: number, channel: number): number {
    return this.numbers.colors[channel * this.count + i] / 255;
  }

  atom(i: number, level: number, k: number): number {
    return this.numbers.code_indices[(level * this.k + k) * this.count + i];
  }

  weight(i: number, level: number, k: number): number {
    return (this.numbers.code_weights[(level * this.k + k) * this.count + i] / 65535) * this.ranges(i).weights_scale;
  }

  confidence(i: number, level: number): number {
    return this.numbers.confidence[level * this.count + i] / 255;
  }

  /** Number of the thing that a Gaussian belongs to at a level, or `NO_OWNER`. */
  owner(i: number, level: number): number {
    const { owners } = this.numbers;
    return owners ? owners[level * this.count + i] : NO_OWNER;
  }
}

/** Some rows of the last axis. */
function rowsOf({ data, shape }: Tensor, from: number, to: number): Tensor {
  const [before, count] = [shape.slice(0, -1), shape[shape.length - 1]];
  const lines = before.reduce((product, size) => product * size, 1);
  const out = empty(data, lines * (to - from));
  for (let line = 0; line < lines; line++) out.set(data.subarray(line * count + from, line * count + to), line * (to - from));
  return { data: out, shape: [...before, to - from] };
}

/** Tensors one after another along the last axis. */
function joined(tensors: Tensor[]): Tensor {
  const before = tensors[0].shape.slice(0, -1);
  const lines = before.reduce((product, size) => product * size, 1);
  const counts = tensors.map(({ shape }) => shape[shape.length - 1]);
  const total = counts.reduce((sum, count) => sum + count, 0);
  const out = empty(tensors[0].data, lines * total);
  let start = 0;
  tensors.forEach(({ data }, part) => {
    const count = counts[part];
    for (let line = 0; line < lines; line++) out.set(data.subarray(line * count, (line + 1) * count), line * total + start);
    start += count;
  });
  return { data: out, shape: [...before, total] };
}

function empty(like: TensorData, length: number): TensorData {
  return new (like.constructor as new (length: number) => TensorData)(length);
}
