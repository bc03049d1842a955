// The scene as it comes from Python (docs/formats.md, "Scene of a page").
import type { Packed, Tensor } from "./safetensors";

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
  cameras: CameraRecord[];
}

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

  constructor(packed: Packed) {
    this.metadata = packed.metadata as Metadata & Ranges;
    if (this.metadata.version !== 1) throw new Error(`this page cannot read version ${this.metadata.version} of its scene`);
    this.tensors = packed.tensors;
    this.count = this.tensor("opacities").data.length;
    const [levels, k] = this.tensor("code_indices").shape;
    [this.levels, this.k, this.atoms] = [levels, k, this.metadata.n_atoms];
    this.phrases = this.tensors.get("canonical")?.shape[1] ?? 0;
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
    const { data } = this.tensor("means");
    const n = this.count;
    const value = data[axis * n + i] * 65536 + data[(3 + axis) * n + i] * 256 + data[(6 + axis) * n + i];
    const { means_low: low, means_high: high } = this.metadata;
    return low[axis] + (value / 16777215) * (high[axis] - low[axis]);
  }

  /** Standard deviation along an axis of a Gaussian's own frame. */
  scale(i: number, axis: number): number {
    const { scales_low: low, scales_high: high } = this.metadata;
    return Math.exp(low + (this.tensor("scales").data[axis * this.count + i] / 255) * (high - low));
  }

  /** Rotation w, x, y, z of norm 1. */
  quat(i: number): [number, number, number, number] {
    const { data } = this.tensor("quats");
    const q = [0, 1, 2, 3].map((part) => data[part * this.count + i]);
    const norm = Math.hypot(...q) || 1;
    return [q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm];
  }

  opacity(i: number): number {
    return this.tensor("opacities").data[i] / 255;
  }

  color(i: number, channel: number): number {
    return this.tensor("colors").data[channel * this.count + i] / 255;
  }

  atom(i: number, level: number, k: number): number {
    return this.tensor("code_indices").data[(level * this.k + k) * this.count + i];
  }

  weight(i: number, level: number, k: number): number {
    const value = this.tensor("code_weights").data[(level * this.k + k) * this.count + i];
    return (value / 65535) * this.metadata.weights_scale;
  }

  confidence(i: number, level: number): number {
    return this.tensor("confidence").data[level * this.count + i] / 255;
  }
}
