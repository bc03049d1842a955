// Boxes around the things that are selected, the line between two of them, and a length that is measured.
import * as THREE from "three";
import type { World } from "./camera";
import { SELECTED } from "./shader";
import type { Thing } from "./scene_data";

/** Corners of a box are numbered by the signs of their coordinates; an edge joins two that differ in one. */
const EDGES = [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5], [2, 6], [3, 7]];

export class Boxes {
  readonly lines = new THREE.LineSegments(
    new THREE.BufferGeometry(),
    new THREE.LineBasicMaterial({ depthTest: false, transparent: true, color: new THREE.Color(...SELECTED), toneMapped: false }),
  );

  constructor(private readonly world: World) {
    this.lines.renderOrder = 10; // over the splat
    this.lines.frustumCulled = false;
    this.lines.visible = false;
  }

  update(things: Thing[], measured: number[][]): void {
    const points = things.flatMap((thing) => {
      const corners = Array.from({ length: 8 }, (_, corner) => this.corner(thing.box, corner));
      return EDGES.flat().map((corner) => corners[corner]);
    });
    for (const ends of [things.map(({ position }) => position), measured]) {
      if (ends.length === 2) points.push(...ends.map((end) => this.place(end)));
    }
    this.lines.visible = points.length > 0;
    this.lines.geometry.dispose();
    this.lines.geometry = new THREE.BufferGeometry().setFromPoints(points);
  }

  private corner({ centre, axes, extent }: Thing["box"], corner: number): THREE.Vector3 {
    const point = [...centre];
    for (const [axis, direction] of axes.entries()) {
      const sign = (corner >> axis) & 1 ? 0.5 : -0.5;
      for (let part = 0; part < 3; part++) point[part] += sign * extent[axis] * direction[part];
    }
    return this.place(point);
  }

  private place(point: number[]): THREE.Vector3 {
    return this.world.toPage(new THREE.Vector3().fromArray(point));
  }
}
