// The list of cameras that the field was built from.
import type { Source } from "./answers";
import { button, byId, element } from "./dom";
import type { CameraRecord } from "./scene_data";

export class CameraList {
  private readonly buttons: HTMLButtonElement[];

  constructor(cameras: CameraRecord[], source: Source, onPick: (camera: CameraRecord) => void) {
    this.buttons = cameras.map((camera, number) => {
      const made = button(camera.name, () => onPick(camera), { "data-name": camera.name });
      const picture = source.thumbnail(number);
      if (picture) made.prepend(element("img", { alt: "", loading: "lazy", src: picture }));
      return made;
    });
    byId("camera-list").replaceChildren(...this.buttons.map((button) => element("li", {}, button)));
    byId("cameras").hidden = !cameras.length;
  }

  /** Mark the camera that is looked through. */
  mark(name: string | null): void {
    for (const button of this.buttons) {
      button.ariaCurrent = button.dataset.name === name ? "true" : null;
    }
  }
}
