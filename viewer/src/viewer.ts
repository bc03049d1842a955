// The page as a whole: joins picture, panel and answers.
import type { Place, Settings, Source } from "./answers";
import { mayAnimate } from "./appearance";
import { Eye } from "./camera";
import { listCameras, markCamera } from "./cameras";
import { commandLine, python } from "./commands";
import { completeFrom } from "./completion";
import { announce, byId, copy, counted, save } from "./dom";
import { ExactPicture } from "./exact";
import type { ExportedPage } from "./exported";
import { Hovering } from "./hovering";
import { listenToKeys } from "./keys";
import { Panel } from "./panel";
import { hits, middle, placeAlong, type Painted } from "./picking";
import { Parts } from "./parts";
import { hidePlace, showPlace } from "./place_panel";
import { owned, plyOf, selected } from "./ply";
import { Scene, type CameraRecord, type Metadata } from "./scene_data";
import { SelectionOutline } from "./selection_outline";
import { Ruler } from "./ruler";
import type { LiveServer } from "./server";
import { RemoteStage, SplatStage, type Stage } from "./stage";
import { State } from "./state";
import { showTab } from "./tabs";
import { ThingPanel } from "./thing_panel";
import { Things } from "./things";

/** Pixels that a click may move without being a drag. */
const CLICK_SLACK = 4;
const NOTE_SECONDS = 4;
/** After which it is said that an answer takes time. */
const PATIENCE_SECONDS = 0.3;

export class Viewer {
  readonly state: State;
  readonly eye: Eye;
  readonly stage: Stage;
  private readonly panel: Panel;
  private readonly ruler: Ruler;
  private readonly exact: ExactPicture | null;
  private readonly canvas = byId<HTMLCanvasElement>("canvas");
  private clicks = 0;
  private thingPanel: ThingPanel | null = null;
  /** The point that was clicked last, until the camera moves. */
  private clicked: [number, number] | null = null;
  /** Say again where the place of the panel is. */
  private sayWhere: () => void = () => {};
  private hovering: Hovering | null = null;
  private readonly outlines: SelectionOutline | null;
  /** Parts of which some are merged; null while that changes. */
  private parts: Parts | null = null;
  /** Resolves when the page holds all parts of the scene, and those whole that are near since the last movement. */
  whole = Promise.resolve();

  private constructor(
    readonly settings: Settings,
    readonly metadata: Metadata,
    private readonly source: Source,
    private readonly server: LiveServer | null,
    private scene: Scene | null,
  ) {
    this.state = new State(metadata.levels.length, metadata.metres_per_unit);
    this.eye = new Eye(metadata, this.canvas);
    const onError = (sentence: string) => this.say(sentence);
    this.stage = scene
      ? new SplatStage(this.canvas, this.eye, this.state, onError)
      : new RemoteStage(this.canvas, this.eye, this.state, server!, onError);
    this.exact = scene && server
      ? new ExactPicture(byId("picture"), byId("badge"), byId("exact-show"), this.eye, this.state, server, onError)
      : null;
    this.outlines = scene ? new SelectionOutline(() => this.scene!, () => this.stage.drawn(), this.eye, this.state, this.canvas) : null;
    this.panel = new Panel(this.state, metadata, !scene);
    this.ruler = new Ruler(this.state, settings.field, onError);
    listCameras(metadata.cameras, source, (camera) => void this.flyTo(camera));
    this.state.onChange = () => this.changed();
    this.eye.onMove = () => this.moved();
    this.panel.update();
    this.listen();
  }

  /** A page with what it shows; without a scene the pictures come from the server. */
  static async open(
    settings: Settings,
    source: Source,
    server: LiveServer | null,
    withGaussians: boolean,
    progress: (stage: string, done: number, total: number) => void,
  ): Promise<Viewer> {
    const scene = withGaussians ? new Scene(await source.scene(progress)) : null;
    const metadata = scene?.metadata ?? (await source.metadata());
    const viewer = new Viewer(settings, metadata, source, server, scene);
    if (scene && viewer.stage instanceof SplatStage) await viewer.stage.load(scene, progress);
    viewer.describe();
    if (metadata.cameras.length) await viewer.flyTo(metadata.cameras[0], false);
    viewer.prepareWords(scene && metadata.n_things ? viewer.listThings() : null).catch((error: Error) => viewer.say(error.message));
    viewer.stage.redraw();
    if (metadata.parts) viewer.whole = viewer.loadParts(scene!);
    return viewer;
  }

  /** How many Gaussians it shows itself. */
  get gaussians(): number {
    return this.scene?.count ?? 0;
  }

  /** How many of them the next frame has. */
  get drawing(): number {
    return this.stage instanceof SplatStage ? this.stage.drawing : 0;
  }

  /** Show the parts of the scene in place of its coarse Gaussians. */
  private async loadParts(scene: Scene): Promise<void> {
    const stage = this.stage as SplatStage;
    const parts: Parts = new Parts(scene, this.source, (part, instead) => stage.swap(part, instead, parts.coarse));
    try {
      await parts.load(this.camera);
      this.take(parts);
    } catch (error) {
      this.say(`A part of the scene is missing: ${(error as Error).message}`);
      return;
    }
    if (scene.metadata.most) await this.unmerge(parts, scene.metadata.most);
  }

  /** Show whole what is near. */
  private async unmerge(parts: Parts, most: number): Promise<void> {
    this.parts = null;
    try {
      await parts.unmerge(() => this.stage.drawn(), this.camera, most);
    } catch (error) {
      this.say(`A part of the scene stays merged: ${(error as Error).message}`);
    }
    this.take(parts);
    this.parts = parts;
  }

  /** From now on the scene is what its parts show. */
  private take(parts: Parts): void {
    if (this.scene === parts.joined()) return;
    this.scene = parts.joined();
    this.outlines?.changed();
    this.describe();
  }

  private readonly camera = () => this.eye.record(this.canvas.clientWidth, this.canvas.clientHeight);

  /** Ask texts; several are separated by commas. */
  async ask(texts: string[]): Promise<void> {
    this.say("");
    showTab("answers");
    // A text model may have to be loaded first, which takes seconds.
    const asking = byId("asking");
    const timer = window.setTimeout(() => (asking.textContent = `Looking for ${texts.join(", ")} …`), PATIENCE_SECONDS * 1000);
    try {
      const answers = await this.source.ask(texts);
      this.state.add(answers);
      const told = answers.map(({ text, present, certainty, score, gaussians, chosen_things: things }) => (
        { text, present, certainty, score, gaussians, things }));
      announce("asked", { answers: told });
    } catch (error) {
      this.say((error as Error).message);
    } finally {
      clearTimeout(timer);
      asking.textContent = "";
    }
  }

  async flyTo(camera: CameraRecord, flies = mayAnimate()): Promise<void> {
    await this.eye.flyTo(camera, flies);
  }

  /** From now on clicks select things. */
  private async listThings(): Promise<void> {
    try {
      const things = new Things(await this.source.things(), `scoup names ${this.settings.identity}`);
      const actions = {
        save: () => void this.saveSelection(),
        place: () => void (this.clicked && this.point(...this.clicked)),
      };
      this.state.things = things;
      this.thingPanel = new ThingPanel(things, this.state, this.metadata.levels, actions);
      const under = (x: number, y: number) => things.under(this.scene!, this.along(x, y), this.state.clickLevel);
      this.hovering = new Hovering(() => this.scene!, this.eye, things, under);
      things.onChange = () => this.changed();
      window.addEventListener("hashchange", () => void this.followLink(things));
      await this.followLink(things);
    } catch (error) {
      this.say((error as Error).message);
    }
  }

  /** Show the thing of a link such as scene.html#thing=12. */
  private async followLink(things: Things): Promise<void> {
    const linked = things.all.find(({ number }) => location.hash === `#thing=${number}`);
    if (!linked) return;
    showTab("things");
    things.select([linked.number]);
    await this.eye.lookAt(linked.position, Math.max(...linked.box.extent), this.metadata.cameras);
  }

  /** Select the thing at a point of the picture; without things, say what is there. Or measure. */
  click(x: number, y: number, event: { shiftKey: boolean; altKey: boolean }): void {
    const { things, measured } = this.state;
    if (measured) return void this.measure(x, y);
    if (!things) return void this.point(x, y);
    this.clicked = [x, y];
    hidePlace();
    things.click(this.scene!, this.along(x, y), this.state.clickLevel, { adds: event.shiftKey, part: event.altKey });
    const last = things.selected.at(-1);
    if (last !== undefined) this.eye.lookAround(things.of(last).position);
  }

  /** The Gaussians that are seen at a point; without those that are hidden, unless `whole`. */
  private along(x: number, y: number, whole = false): Painted[] {
    const isHidden = (gaussian: number) => !whole && (this.state.things?.hides(this.scene!, gaussian) ?? false);
    return hits(this.scene!, this.ray(x, y), 1 / this.camera().K[4], isHidden);
  }

  private readonly ray = (x: number, y: number) => this.eye.ray(x, y, this.canvas.clientWidth, this.canvas.clientHeight);

  /** Say what is at a point of the picture, in its own pixels. */
  async point(x: number, y: number): Promise<void> {
    const place = await this.marked(x, y, () => this.placeAt(x, y));
    if (!place) return;
    showTab("answers");
    this.sayWhere = showPlace(place, this.state);
    if (place.position) this.eye.lookAround(place.position);
  }

  private async measure(x: number, y: number): Promise<void> {
    const place = await this.marked(x, y, () => (this.scene ? middle(this.ray(x, y), this.along(x, y)) : this.placeAt(x, y)));
    if (place?.position) this.ruler.add(place.position);
    else if (place) this.say("Nothing is at this point: click on something.");
  }

  /** Mark a point and find what is there; null if that fails, or if another point is clicked meanwhile. */
  private async marked<Found>(x: number, y: number, find: () => Found | Promise<Found>): Promise<Found | null> {
    this.say("");
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const marker = byId("marker");
    // In units of the height, with which the picture grows and shrinks: what is said of the place may take room from it.
    marker.style.left = `calc(50% + ${(100 * (x - width / 2)) / height}cqh)`;
    marker.style.top = `${(100 * y) / height}%`;
    marker.hidden = false;
    const number = ++this.clicks;
    try {
      const place = await find();
      return number === this.clicks ? place : null;
    } catch (error) {
      this.say((error as Error).message);
      return null;
    }
  }

  private async placeAt(x: number, y: number): Promise<Place> {
    const [server, scene, { things }] = [this.server, this.scene!, this.state];
    const isHidden = things?.hidden.size && this.along(x, y, true).some(({ gaussian }) => things.hides(scene, gaussian));
    if (server && !isHidden) return server.point(this.camera(), [x, y]);
    const [ray, painted] = [this.ray(x, y), this.along(x, y)];
    // The server knows the words, but not what is hidden here: names of things take their place.
    if (server) return { ...middle(ray, painted), levels: things!.along(scene, painted) };
    return placeAlong(scene, ray, painted, await (this.source as ExportedPage).clickWords());
  }

  say(sentence: string): void {
    byId("message").textContent = sentence;
  }

  toggleExact(): void {
    if (!this.exact) return;
    if (this.exact.isWanted) this.exact.hide();
    else this.exact.show();
  }

  private changed(): void {
    this.panel.update();
    this.ruler.update();
    this.sayWhere();
    this.thingPanel?.update();
    this.stage.update();
    this.outlines?.changed();
    this.exact?.changed();
  }

  private moved(): void {
    byId("marker").hidden = true;
    this.clicked = null;
    markCamera(this.eye.at?.name ?? null);
    this.reframed();
  }

  /** The picture has another camera or size. */
  private reframed(): void {
    this.hovering?.leave();
    this.exact?.moved();
    this.stage.redraw();
    void this.outlines?.moved();
    if (this.parts && this.metadata.most) this.whole = this.unmerge(this.parts, this.metadata.most);
  }

  private listen(): void {
    byId("ask").addEventListener("submit", (event) => {
      event.preventDefault();
      const box = byId<HTMLInputElement>("text");
      const texts = box.value.split(",").map((text) => text.trim()).filter(Boolean);
      if (texts.length) void this.ask(texts).then(() => box.select());
    });
    let pressed: PointerEvent | null = null;
    this.canvas.addEventListener("pointerdown", (event) => {
      pressed = event.isPrimary && event.button === 0 ? event : null;
    });
    this.canvas.addEventListener("pointerup", (event) => {
      if (!pressed || Math.hypot(event.clientX - pressed.clientX, event.clientY - pressed.clientY) > CLICK_SLACK) return;
      this.click(event.offsetX, event.offsetY, event);
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (event.pointerType === "mouse" && !event.buttons) this.hovering?.at(event.offsetX, event.offsetY);
    });
    this.canvas.addEventListener("pointerleave", () => this.hovering?.leave());
    new ResizeObserver(() => this.reframed()).observe(byId("stage"));
    byId("save-picture").addEventListener("click", () => this.savePicture());
    byId("save-selection").addEventListener("click", () => void this.saveSelection());
    byId("copy-command").addEventListener("click", () => void this.copied(this.command()));
    byId("copy-python").addEventListener("click", () => void this.copied(this.python()));
    byId("exact").hidden = !this.exact;
    byId("exact-show").addEventListener("click", () => this.toggleExact());
    byId<HTMLInputElement>("exact-rest").addEventListener("change", (event) => {
      if (!this.exact) return;
      this.exact.whenResting = (event.target as HTMLInputElement).checked;
      this.exact.moved();
    });
    listenToKeys(this.state, this.eye, {
      toggleExact: () => this.toggleExact(),
      measure: () => this.ruler.toggle(),
      escape: () => {
        hidePlace();
        if (this.state.measured) this.ruler.toggle();
        else this.state.things?.select([]);
      },
    });
    this.server?.watch((state) => {
      byId("closed-text").textContent =
        state === "other"
          ? "Another field is served here now. Open the address that scoup view printed, or reload this page."
          : `The server was closed. Start it again: ${this.settings.open}`;
      byId("closed").hidden = state === "alive";
      if (state !== "alive") return;
      this.say("");
      this.stage.redraw(); // pictures may have failed meanwhile
    });
  }

  command(): string {
    return commandLine(this.settings, this.state, this.metadata.levels, this.eye.at?.name ?? null);
  }

  python(): string {
    return python(this.settings, this.state, this.metadata.levels, this.eye.at?.name ?? null);
  }

  private async copied(text: string): Promise<void> {
    await copy(text);
    const note = byId("note");
    note.textContent = `Copied: ${text.trim().split("\n")[0]} …`;
    setTimeout(() => (note.textContent = ""), NOTE_SECONDS * 1000);
  }

  /** Once all that was asked for is drawn. */
  async drawn(): Promise<void> {
    await Promise.all([this.stage.drawn(), this.outlines?.drawn()]);
  }

  /** What is seen of the scene with what is selected, [W x H] RGBA. */
  snapshot(): HTMLCanvasElement {
    const picture = this.stage.snapshot();
    this.outlines?.drawOn(picture);
    return picture;
  }

  private savePicture(): void {
    const exact = byId<HTMLImageElement>("picture");
    if (!exact.hidden) {
      void fetch(exact.src).then((response) => response.blob()).then((blob) => save(blob, "exact_picture.jpg"));
      return;
    }
    this.snapshot().toBlob((blob) => blob && save(blob, "picture.png"), "image/png");
  }

  async saveSelection(): Promise<void> {
    const selection = this.state.selection();
    this.say("");
    try {
      if (!selection.texts.length && !selection.things.length) {
        throw new Error("Nothing is selected: click a thing or ask for something first.");
      }
      if (this.server) {
        const { blob, name } = await this.server.select(selection);
        save(blob, name);
        return;
      }
      const { things, rest } = selection;
      const rows = things.length
        ? owned(this.scene!, things.map(({ number }) => number), rest)
        : selected(this.scene!, this.state.shown(), rest);
      if (!rows.length) throw new Error("No Gaussian is selected; try a lower threshold.");
      const name = things.length ? things[0].name.replaceAll(/[^\p{L}\p{N}]/gu, "_") : "selection";
      save(plyOf(this.scene!, rows, things.map(({ number, name }) => `thing ${number}: ${name}`)), `${rest ? "without_" : ""}${name}.ply`);
    } catch (error) {
      this.say((error as Error).message);
    }
  }

  /** Facts of the scene. */
  private describe(): void {
    const { metadata, scene } = this;
    document.title = `${metadata.name} – SCOUP`;
    byId("title").textContent = metadata.name;
    const all = counted(metadata.n_gaussians, "Gaussian");
    const some = scene && scene.count < metadata.n_gaussians;
    const full = this.server ? "; the exact picture has all" : "";
    const count = scene?.count.toLocaleString("en");
    const shown = scene?.metadata.parts
      ? `${count} of ${all} shown, more are loading`
      : some ? `${count} of ${all} shown, neighbours merged${full}` : all;
    byId("facts").textContent = `${shown}. Embeddings: ${metadata.embedding_model || "unnamed model"}. SCOUP ${this.settings.version}.`;
  }

  /** Words that the text box completes and, once things are listed, proposes; or why none can be asked. */
  private async prepareWords(listing: Promise<void> | null): Promise<void> {
    const { metadata } = this;
    if (metadata.words_problem !== null) {
      this.say(`No text can be asked: ${metadata.words_problem}`);
      for (const part of byId("ask").querySelectorAll<HTMLInputElement | HTMLButtonElement>("input, button")) part.disabled = true;
      return;
    }
    const { names, closed } = await this.source.vocabulary();
    const box = byId<HTMLInputElement>("text");
    completeFrom(names);
    if (closed) box.title = `one of ${names.length.toLocaleString("en")} words`;
    await listing;
    const objects = (this.state.things?.all ?? []).filter(({ level }) => level === this.state.clickLevel);
    const seen = objects.sort((a, b) => b.gaussians - a.gaussians).map(({ name }) => name);
    box.placeholder = [...new Set([...seen.filter((name) => name && names.includes(name)), ...names])].slice(0, 2).join(", ");
  }
}
