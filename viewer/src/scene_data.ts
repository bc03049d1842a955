// The scene as it comes from Python (docs/formats.md, "Scene of a page").
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
  centre: [number, number, number];
  radius: number;
  embedding_model: string;
  words_problem: string | null;
  present_from: number | null;
  /** Whether the whole scene has more Gaussians than this file. */
  coarse?: boolean;
  /** Things of all levels; missing where the field has none. */
  n_things?: number;
  cameras: CameraRecord[];
}

/** The facts of a thing, as Python has them (`CodedScene.things`); lengths in the units of the scene. */
export interface Thing {
  number: number;
  /** Position of its level, fine to coarse. */
  level: number;
  /** Number of the thing it is a part of. */
  parent: number | null;
  /** The word of the vocabulary that fits best. */
  name: string | null;
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
  private readonly means: TensorData;
  private readonly scales: TensorData;
  private readonly quats: TensorData;
  private readonly colors: TensorData;
  private readonly opacities: TensorData;
  private readonly indices: TensorData;
  private readonly weights: TensorData;
  private readonly sureness: TensorData;
  private readonly owners: TensorData | null;
  private knownBalls: Float32Array | null = null;

  constructor(packed: Packed) {
    this.metadata = packed.metadata as Metadata & Ranges;
    if (this.metadata.version !== 1) throw new Error(`this page cannot read version ${this.metadata.version} of its scene`);
    this.tensors = packed.tensors;
    this.means = this.tensor("means").data;
    this.scales = this.tensor("scales").data;
    this.quats = this.tensor("quats").data;
    this.colors = this.tensor("colors").data;
    this.opacities = this.tensor("opacities").data;
    this.indices = this.tensor("code_indices").data;
    this.weights = this.tensor("code_weights").data;
    this.sureness = this.tensor("confidence").data;
    this.owners = this.tensors.get("owners")?.data ?? null;
    this.count = this.opacities.length;
    const [levels, k] = this.tensor("code_indices").shape;
    [this.levels, this.k, this.atoms] = [levels, k, this.metadata.n_atoms];
    this.phrases = this.tensors.get("canonical")?.shape[1] ?? 0;
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
    const { means, count } = this;
    const value = means[axis * count + i] * 65536 + means[(3 + axis) * count + i] * 256 + means[(6 + axis) * count + i];
    const { means_low: low, means_high: high } = this.metadata;
    return low[axis] + (value / 16777215) * (high[axis] - low[axis]);
  }

  /** Standard deviation along an axis of a Gaussian's own frame. */
  scale(i: number, axis: number): number {
    const { scales_low: low, scales_high: high } = this.metadata;
    return Math.exp(low + (this.scales[axis * this.count + i] / 255) * (high - low));
  }

  /** Rotation w, x, y, z of norm 1. */
  quat(i: number): [number, number, number, number] {
    const { quats, count } = this;
    const [w, x, y, z] = [quats[i], quats[count + i], quats[2 * count + i], quats[3 * count + i]];
    const norm = Math.sqrt(w * w + x * x + y * y + z * z) || 1;
    return [w / norm, x / norm, y / norm, z / norm];
  }

  opacity(i: number): number {
    return this.opacities[i] / 255;
  }

  color(i: number, channel: number): number {
    return this.colors[channel * this.count + i] / 255;
  }

  atom(i: number, level: number, k: number): number {
    return this.indices[(level * this.k + k) * this.count + i];
  }

  weight(i: number, level: number, k: number): number {
    return (this.weights[(level * this.k + k) * this.count + i] / 65535) * this.metadata.weights_scale;
  }

  confidence(i: number, level: number): number {
    return this.sureness[level * this.count + i] / 255;
  }

  /** Number of the thing that a Gaussian belongs to at a level, or `NO_OWNER`. */
  owner(i: number, level: number): number {
    return this.owners ? this.owners[level * this.count + i] : NO_OWNER;
  }
}
