// The list of cameras that the field was built from.
import type { Source } from "./answers";
import { button, byId, element } from "./dom";
import type { CameraRecord } from "./scene_data";

export function listCameras(cameras: CameraRecord[], source: Source, onPick: (camera: CameraRecord) => void): void {
  const rows = cameras.map((camera, number) => {
    const row = button(camera.name, () => onPick(camera), { "data-name": camera.name });
    const picture = source.thumbnail(number);
    if (picture) row.prepend(element("img", { alt: "", loading: "lazy", src: picture }));
    return element("li", {}, row);
  });
  byId("camera-list").replaceChildren(...rows);
  byId("cameras").hidden = !cameras.length;
}

/** Mark the camera that is looked through. */
export function markCamera(name: string | null): void {
  for (const row of byId("camera-list").querySelectorAll("button")) row.ariaCurrent = row.dataset.name === name ? "true" : null;
}
