// The list of cameras that the field was built from.
import type { Source } from "./answers";
import { byId, element } from "./dom";
import type { CameraRecord } from "./scene_data";

export class CameraList {
  private readonly buttons: HTMLButtonElement[];

  constructor(cameras: CameraRecord[], source: Source, onPick: (camera: CameraRecord) => void) {
    this.buttons = cameras.map((camera, number) => {
      const button = element("button", { type: "button" });
      const picture = source.thumbnail(number);
      if (picture) button.append(element("img", { alt: "", loading: "lazy", src: picture }));
      button.append(camera.name);
      button.addEventListener("click", () => onPick(camera));
      button.dataset.name = camera.name;
      return button;
    });
    byId("camera-list").replaceChildren(...this.buttons.map((button) => element("li", {}, button)));
    byId("cameras").hidden = !cameras.length;
  }

  /** Mark the camera that is looked through. */
  mark(name: string | null): void {
    for (const button of this.buttons) {
      if (button.dataset.name === name) button.setAttribute("aria-current", "true");
      else button.removeAttribute("aria-current");
    }
  }
}
