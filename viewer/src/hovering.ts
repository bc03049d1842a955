// What is under the pointer: the name of the thing and its outline. The scene is not drawn again for it.
import type { Eye } from "./camera";
import { byId } from "./dom";
import { membersOf, Silhouette } from "./outline";
import type { Scene } from "./scene_data";
import type { Things } from "./things";

const WHITE = [1, 1, 1] as const;

export class Hovering {
  private readonly label = byId("hovering");
  private readonly outline = byId<HTMLCanvasElement>("outline");
  private readonly canvas = byId<HTMLCanvasElement>("canvas");
  private point: [number, number] | null = null;
  private isDue = false;

  /**
   * @param scene what the page shows now, which may be a coarse one at first
   * @param under the thing at a point of the picture
   */
  constructor(
    private readonly scene: () => Scene,
    private readonly eye: Eye,
    private readonly things: Things,
    private readonly under: (x: number, y: number) => number | null,
  ) {
    things.onHover = () => this.show();
  }

  /** The pointer has moved. What is under it is found once per frame at most. */
  at(x: number, y: number): void {
    this.point = [x, y];
    if (this.isDue) return;
    this.isDue = true;
    requestAnimationFrame(() => {
      this.isDue = false;
      if (!this.point) return;
      const [x, y] = this.point;
      [this.label.style.left, this.label.style.top] = [`${x + 14}px`, `${y + 14}px`];
      this.things.hover(this.under(x, y));
    });
  }

  /** The pointer is elsewhere, or the camera has moved. */
  leave(): void {
    this.point = null;
    this.things.hover(null);
  }

  private show(): void {
    const { hovered } = this.things;
    const scene = this.scene();
    this.label.hidden = this.outline.hidden = hovered === null;
    if (hovered === null) return;
    this.label.textContent = this.things.nameOf(hovered);
    const silhouette = new Silhouette(this.eye, this.canvas);
    silhouette.add(scene, membersOf(scene, this.things.of(hovered)));
    silhouette.prepare(this.outline);
    silhouette.outline(this.outline, WHITE);
  }
}
