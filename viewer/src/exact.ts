// The method's own picture of the current camera, rendered by the server, over the page's.
import type { Eye } from "./camera";
import { patiently, type LiveServer } from "./server";
import type { State } from "./state";

const REST_SECONDS = 0.4;
const QUALITY = 92;
/** After which a busy server is asked again. */
const BUSY_SECONDS = 0.5;

export class ExactPicture {
  /** Whether to show it by itself when the camera rests. */
  whenResting = false;
  private wanted = false;
  private running = false;
  private number = 0;
  private timer = 0;
  /** What the picture that was received last shows. */
  private received = "";

  constructor(
    private readonly image: HTMLImageElement,
    private readonly badge: HTMLElement,
    private readonly button: HTMLElement,
    private readonly eye: Eye,
    private readonly state: State,
    private readonly server: LiveServer,
    private readonly onError: (sentence: string) => void,
  ) {}

  /** Whether it is seen, or on its way. */
  get isWanted(): boolean {
    return this.wanted;
  }

  /** The camera has moved: the picture is of another view now. */
  moved(): void {
    this.hide();
    clearTimeout(this.timer);
    if (this.whenResting) this.timer = window.setTimeout(() => this.show(), REST_SECONDS * 1000);
  }

  /** Texts or settings have changed. */
  changed(): void {
    if (this.wanted || this.whenResting) this.show();
  }

  hide(): void {
    this.number += 1;
    this.wanted = false;
    this.image.hidden = this.badge.hidden = true;
    this.button.setAttribute("aria-pressed", "false");
  }

  show(): void {
    this.number += 1;
    this.wanted = true;
    this.button.setAttribute("aria-pressed", "true");
    if (!this.running) void this.run();
  }

  /** One request at a time, until the newest is answered: a slider would fill the server's queue otherwise. */
  private async run(): Promise<void> {
    this.running = true;
    try {
      for (let number = -1; this.wanted && number !== this.number; ) {
        number = this.number;
        try {
          await this.receive(number);
        } catch (error) {
          if (number !== this.number) continue;
          this.hide();
          this.onError((error as Error).message);
        }
      }
    } finally {
      this.running = false;
    }
  }

  private async receive(number: number): Promise<void> {
    const { clientWidth: width, clientHeight: height } = this.image.parentElement!;
    const request = this.state.picture(this.eye.record(width, height), QUALITY);
    const what = JSON.stringify(request);
    if (what !== this.received) {
      this.badge.textContent = "rendering the exact picture …";
      this.badge.hidden = false;
      const blob = await patiently(() => this.server.picture(request), BUSY_SECONDS);
      if (number !== this.number) return;
      URL.revokeObjectURL(this.image.src);
      this.received = "";
      this.image.src = URL.createObjectURL(blob);
      await this.image.decode();
      this.received = what;
      if (number !== this.number) return;
    }
    const texts = request.texts.map((text) => `“${text}”`).join(", ");
    this.badge.textContent = `exact picture${texts && ` of ${texts}`} (rendered codes, all Gaussians)`;
    this.image.hidden = this.badge.hidden = false;
  }
}
