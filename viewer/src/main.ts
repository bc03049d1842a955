// Starts the page: settings, source of answers, progress, and what tests may hold.
import type { Settings, Source } from "./answers";
import { prepareAppearance } from "./appearance";
import { byId } from "./dom";
import { ExportedPage } from "./exported";
import { LiveServer } from "./server";
import type { Mode } from "./shader";
import { prepareTabs } from "./tabs";
import { Viewer } from "./viewer";

declare global {
  interface Window {
    scoupViewer?: ReturnType<typeof handle>;
  }
}

function progress(stage: string, done: number, total: number): void {
  const megabytes = (bytes: number) => (bytes / 1e6).toFixed(1);
  const share = total ? done / total : 0;
  byId<HTMLProgressElement>("loading-bar").value = share;
  const texts: Record<string, string> = {
    loading: `Loading: ${megabytes(done)} of ${megabytes(total)} MB`,
    opening: "Unpacking …",
  };
  byId("loading-text").textContent =
    texts[stage] ?? `Unpacking: ${done.toLocaleString("en")} of ${total.toLocaleString("en")} Gaussians`;
}

function hasWebGL(): boolean {
  return document.createElement("canvas").getContext("webgl2") !== null;
}

async function start(settings: Settings): Promise<Viewer> {
  const server = settings.mode === "exported" ? null : new LiveServer(settings.identity);
  const source: Source = server ?? new ExportedPage();
  const able = hasWebGL();
  if (!able && !server) throw new Error("This page needs WebGL 2, which this browser does not offer.");
  const viewer = await Viewer.open(settings, source, server, settings.mode !== "remote" && able, progress);
  byId("loading").hidden = true;
  if (!able && settings.mode === "live") {
    viewer.say("This browser offers no WebGL 2: the server renders the pictures instead.");
  }
  return viewer;
}

/** What tests and other scripts may ask of the page. */
function handle(opening: Promise<Viewer>) {
  let viewer: Viewer;
  const ready = opening.then((opened) => {
    viewer = opened;
  });
  return {
    /** Something is shown, and can be asked. */
    ready,
    /** All parts of the scene are shown, and whole ones where the camera is near. To be read again after a movement. */
    get whole(): Promise<void> {
      return ready.then(() => viewer.whole);
    },
    state: () => {
      const { state, eye } = viewer;
      const queries = state.queries.map(({ answer, color, hidden }) => ({ ...answer, scores: undefined, color, hidden }));
      const { level, threshold, opacity, mode } = state;
      const things = state.things && { selected: state.things.selected, hidden: [...state.things.hidden], hovered: state.things.hovered };
      const camera = eye.at?.name ?? null;
      return { queries, things, mode, level, threshold, opacity, camera, gaussians: viewer.gaussians, drawing: viewer.drawing };
    },
    ask: (texts: string[]) => viewer.ask(texts),
    set: ({ mode, ...change }: { mode?: Mode; level?: number | null; threshold?: number | null; opacity?: number }) =>
      viewer.state.set(mode === undefined ? change : { ...change, chosenMode: mode }),
    flyTo: (name: string) => viewer.flyTo(viewer.metadata.cameras.find((camera) => camera.name === name)!, false),
    /** Resolves when everything asked for is drawn. */
    render: () => viewer.drawn(),
    /** What is seen, RGBA row by row from the top, with its width. */
    pixels: () => {
      const canvas = viewer.stage.snapshot();
      const { width, height } = canvas;
      const { data } = canvas.getContext("2d", { willReadFrequently: true })!.getImageData(0, 0, width, height);
      return { data: Array.from(data), width, height };
    },
    command: () => viewer.command(),
    python: () => viewer.python(),
  };
}

prepareAppearance();
prepareTabs();
// Before the page is ready, Enter would load it again.
byId("ask").addEventListener("submit", (event) => event.preventDefault());
const settings = JSON.parse(byId("settings").textContent ?? "{}") as Settings;
byId("help-licences").textContent =
  settings.mode === "exported"
    ? "This page contains three.js and Spark; their licences are at its end."
    : "This page contains three.js and Spark; their licences are in licences.txt of this server.";
const opening = start(settings);
window.scoupViewer = handle(opening);
opening.catch((error: Error) => {
  byId("loading").hidden = false;
  byId("loading-bar").hidden = true;
  byId("loading-text").textContent = error.message;
});
