// The outline of some Gaussians: the edge of what they cover when they are drawn alone.
import type { Eye } from "./camera";
import { BLUR, LEAST_ALPHA, MOST_ALPHA } from "./picking";
import type { CameraRecord, Scene } from "./scene_data";
import type { Color } from "./shader";

const REACH = 3;
/** A thing covers a pixel if less than this share of the light passes. */
const COVERED = 0.5;
/** Pixels that are darker than this are covered, whatever else is drawn. */
const DARK = 0.01;
const RIM = [0, 0, 0, 160];

/** Gaussians that belong to a thing. */
export function membersOf(scene: Scene, { number, level }: { number: number; level: number }): number[] {
  const members = [];
  for (let i = 0; i < scene.count; i++) if (scene.owner(i, level) === number) members.push(i);
  return members;
}

/** An outline is found in so many columns at most. */
const MOST_COLUMNS = 480;
/** Pixels of the picture in one of an outline, at least. */
const LINE = 2;

/** Pixels that some Gaussians cover: products of what passes need no order. */
export class Silhouette {
  private readonly camera: CameraRecord;
  private readonly light: Float32Array;
  /** Pixels of the picture along a side of one of the camera's. */
  private readonly shrunk: number;

  constructor(eye: Eye, { clientWidth, clientHeight }: HTMLElement) {
    this.shrunk = Math.max(LINE, clientWidth / MOST_COLUMNS);
    const [width, height] = [clientWidth, clientHeight].map((side) => Math.max(1, Math.round(side / this.shrunk)));
    this.camera = eye.record(width, height);
    this.light = new Float32Array(width * height).fill(1);
  }

  /** Cover what some Gaussians do, too. */
  add(scene: Scene, members: readonly number[]): void {
    const { viewmat: V, K, width, height } = this.camera;
    const { light } = this;
    const mean = { x: 0, y: 0, z: 0 };
    for (const i of members) {
      scene.mean(i, mean);
      const [x, y, z] = [0, 4, 8].map((row) => V[row] * mean.x + V[row + 1] * mean.y + V[row + 2] * mean.z + V[row + 3]);
      if (z <= 0) continue;
      const [u, v] = [(K[0] * x) / z + K[2], (K[4] * y) / z + K[5]];
      const { xx, xy, yy } = covariance(scene, i, this.camera, [x, y, z], BLUR / this.shrunk ** 2);
      const [rx, ry] = [REACH * Math.sqrt(xx), REACH * Math.sqrt(yy)];
      const [left, right] = [Math.max(0, Math.floor(u - rx)), Math.min(width - 1, Math.floor(u + rx))];
      const [top, bottom] = [Math.max(0, Math.floor(v - ry)), Math.min(height - 1, Math.floor(v + ry))];
      const determinant = xx * yy - xy * xy;
      const opacity = scene.opacity(i);
      for (let row = top; row <= bottom; row++) {
        const b = row + 0.5 - v;
        for (let column = left; column <= right; column++) {
          const place = row * width + column;
          if (light[place] < DARK) continue;
          const a = column + 0.5 - u;
          const squared = (yy * a * a - 2 * xy * a * b + xx * b * b) / determinant;
          const alpha = Math.min(MOST_ALPHA, opacity * Math.exp(-squared / 2));
          if (alpha >= LEAST_ALPHA) light[place] *= 1 - alpha;
        }
      }
    }
  }

  /** Draw a line around it in a colour, and a dark one around that, which is seen on all colours. */
  outline(canvas: HTMLCanvasElement, color: Color): void {
    const { width, height } = this.camera;
    const context = canvas.getContext("2d", { willReadFrequently: true })!;
    const covered = Uint8Array.from(this.light, (passes) => Number(passes < COVERED));
    const line = grown(covered, width, height);
    const rim = grown(line, width, height);
    const picture = context.getImageData(0, 0, width, height);
    const inked = [...color.map((part) => Math.round(255 * part)), 255];
    for (let place = 0; place < covered.length; place++) {
      if (covered[place] || !rim[place]) continue;
      // The lines of others go before this one's rim.
      if (line[place] || !picture.data[4 * place + 3]) picture.data.set(line[place] ? inked : RIM, 4 * place);
    }
    context.putImageData(picture, 0, 0);
  }

  /** Clear a canvas, and give it the size for outlines. */
  prepare(canvas: HTMLCanvasElement): void {
    [canvas.width, canvas.height] = [this.camera.width, this.camera.height];
  }
}

/** What is covered, and its neighbours. */
function grown(covered: Uint8Array, width: number, height: number): Uint8Array {
  const found = covered.slice();
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) {
      const place = row * width + column;
      if (!covered[place]) continue;
      if (column > 0) found[place - 1] = 1;
      if (column < width - 1) found[place + 1] = 1;
      if (row > 0) found[place - width] = 1;
      if (row < height - 1) found[place + width] = 1;
    }
  }
  return found;
}

/** Of a Gaussian at a place before the camera, in the picture. */
function covariance(scene: Scene, i: number, { viewmat: V, K }: CameraRecord, [x, y, z]: number[], blur: number): { xx: number; xy: number; yy: number } {
  const [w, a, b, c] = scene.quat(i);
  const turn = [
    1 - 2 * (b * b + c * c), 2 * (a * b - w * c), 2 * (a * c + w * b),
    2 * (a * b + w * c), 1 - 2 * (a * a + c * c), 2 * (b * c - w * a),
    2 * (a * c - w * b), 2 * (b * c + w * a), 1 - 2 * (a * a + b * b),
  ];
  let [xx, xy, yy] = [blur, 0, blur];
  for (let axis = 0; axis < 3; axis++) {
    const size = scene.scale(i, axis);
    const [dx, dy, dz] = [turn[axis] * size, turn[3 + axis] * size, turn[6 + axis] * size];
    const along = V[8] * dx + V[9] * dy + V[10] * dz;
    const across = (K[0] / z) * (V[0] * dx + V[1] * dy + V[2] * dz - (x / z) * along);
    const down = (K[4] / z) * (V[4] * dx + V[5] * dy + V[6] * dz - (y / z) * along);
    xx += across * across;
    xy += across * down;
    yy += down * down;
  }
  return { xx, xy, yy };
}
