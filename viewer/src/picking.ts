// What is under a point of the picture, found in the browser.
import * as THREE from "three";
import type { Place } from "./answers";
import type { Scene } from "./scene_data";

/** Pixels squared that Inria's rasteriser adds to each projected covariance. */
export const BLUR = 0.3;
/** Standard deviations beyond which even an opaque Gaussian paints less than the least alpha. */
const REACH = 3.4;
export const LEAST_ALPHA = 1 / 255;
export const MOST_ALPHA = 0.99;
const LEAST_LIGHT = 1e-4;
const WORDS_SHOWN = 5;

export interface Painted {
  gaussian: number;
  distance: number;
  weight: number;
}

/**
 * Gaussians along a ray with how much each paints of it, front to back, as blending does.
 *
 * @param pixel angle of a pixel, by which small Gaussians are made wider as the rasteriser does
 * @param skips whether a Gaussian is not drawn
 */
export function hits(scene: Scene, { origin, direction }: THREE.Ray, pixel: number, skips: (gaussian: number) => boolean): Painted[] {
  const { balls } = scene;
  const found: (Omit<Painted, "weight"> & { alpha: number })[] = [];
  const mean = new THREE.Vector3();
  const turn = new THREE.Quaternion();
  const from = new THREE.Vector3();
  const along = new THREE.Vector3();
  for (let i = 0; i < scene.count; i++) {
    // Plain numbers first: this runs for every Gaussian whenever the pointer moves.
    const [x0, y0, z0] = [origin.x - balls[4 * i], origin.y - balls[4 * i + 1], origin.z - balls[4 * i + 2]];
    const ahead = -(x0 * direction.x + y0 * direction.y + z0 * direction.z);
    if (ahead <= 0) continue;
    const blur = BLUR * (pixel * ahead) ** 2;
    const aside = x0 * x0 + y0 * y0 + z0 * z0 - ahead * ahead;
    if (aside > REACH * REACH * (balls[4 * i + 3] ** 2 + blur) || skips(i)) continue;
    scene.mean(i, mean);
    from.subVectors(origin, mean);
    const scales = [0, 1, 2].map((axis) => Math.sqrt(scene.scale(i, axis) ** 2 + blur));
    const [w, x, y, z] = scene.quat(i);
    turn.set(-x, -y, -z, w); // into the frame of the Gaussian, where it is a ball once scaled
    from.applyQuaternion(turn);
    along.copy(direction).applyQuaternion(turn);
    for (const [axis, scale] of scales.entries()) {
      from.setComponent(axis, from.getComponent(axis) / scale);
      along.setComponent(axis, along.getComponent(axis) / scale);
    }
    const nearest = -from.dot(along) / along.lengthSq();
    const squared = Math.max(0, from.lengthSq() - nearest * nearest * along.lengthSq());
    const alpha = Math.min(MOST_ALPHA, scene.opacity(i) * Math.exp(-squared / 2));
    if (alpha >= LEAST_ALPHA && nearest > 0) found.push({ gaussian: i, distance: nearest, alpha });
  }
  found.sort((a, b) => a.distance - b.distance);
  let light = 1;
  const painted = [];
  for (const { gaussian, distance, alpha } of found) {
    painted.push({ gaussian, distance, weight: light * alpha });
    light *= 1 - alpha;
    if (light < LEAST_LIGHT) break;
  }
  return painted;
}

export interface Words {
  names: string[];
  /** [V, S, L] inner products of atoms and words. */
  scores: Float32Array;
  /** [S, L, L] inner products of atoms. */
  gram: Float32Array;
}

/** What the scene says is along a ray: the words that fit the sum of the codes best, level by level. */
export function placeAlong(scene: Scene, ray: THREE.Ray, painted: Painted[], words: Words): Place {
  const levels = painted.length ? scene.metadata.levels.map((level, s) => wordsAt(scene, painted, s, level, words)) : [];
  return { ...middle(ray, painted), levels };
}

/** The point of a ray with half of what is painted along it; null where nothing is. */
export function middle(ray: THREE.Ray, painted: Painted[]): Pick<Place, "position" | "distance"> {
  const total = painted.reduce((sum, { weight }) => sum + weight, 0);
  let light = 0;
  const distance = painted.find(({ weight }) => (light += weight) >= total / 2)?.distance ?? null;
  return { position: distance === null ? null : ray.at(distance, new THREE.Vector3()).toArray(), distance };
}

function wordsAt(scene: Scene, painted: Painted[], s: number, level: string, words: Words): Place["levels"][number] {
  const code = new Float64Array(scene.atoms);
  let share = 0;
  let confidence = 0;
  for (const { gaussian, weight } of painted) {
    const sure = scene.confidence(gaussian, s);
    if (!sure) continue;
    share += weight;
    confidence += weight * sure;
    // The page holds codes of norm 1; the confidence is the norm that they had.
    for (let k = 0; k < scene.k; k++) code[scene.atom(gaussian, s, k)] += weight * sure * scene.weight(gaussian, s, k);
  }
  if (!share) return { level, confidence: 0, words: [] };
  let squared = 0;
  for (let atom = 0; atom < code.length; atom++) {
    if (code[atom]) squared += code[atom] * product(code, words.gram, (s * code.length + atom) * code.length);
  }
  const norm = Math.sqrt(Math.max(squared, 1e-12));
  const canonical = scene.phrases ? (scene.tensor("canonical").data as Float32Array) : new Float32Array();
  let best = -Infinity;
  for (let p = 0; p < scene.phrases; p++) {
    best = Math.max(best, product(code, canonical, (s * scene.phrases + p) * scene.atoms) / norm);
  }
  const ranked = words.names
    .map((text, row) => {
      const cosine = product(code, words.scores, (row * scene.levels + s) * scene.atoms) / norm;
      return { text, relevancy: 1 / (1 + Math.exp(-10 * (cosine - best))) };
    })
    .sort((a, b) => b.relevancy - a.relevancy);
  return { level, confidence: confidence / share, words: ranked.slice(0, WORDS_SHOWN) };
}

function product(code: Float64Array, table: Float32Array, start: number): number {
  let sum = 0;
  for (let atom = 0; atom < code.length; atom++) sum += code[atom] * table[start + atom];
  return sum;
}
