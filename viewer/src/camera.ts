// The camera: orbiting, flying to a camera of the field, and what the server is told of it.
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import type { CameraRecord, Metadata } from "./scene_data";

const FLIGHT_SECONDS = 0.8;
/** Share of the distance that a key moves. */
const STEP = 0.06;

/**
 * The world of a field, and that of the page, in which the middle of the scene is at 0 and its cameras are about 1 away. Spark counts on
 * such lengths: it sorts anew after steps of 0.001, and keeps places as 16-bit numbers.
 */
export class World {
  private readonly centre: THREE.Vector3;
  private readonly radius: number;

  constructor(metadata: Pick<Metadata, "centre" | "radius">) {
    this.centre = new THREE.Vector3(...metadata.centre);
    this.radius = metadata.radius;
  }

  toPage(point: THREE.Vector3): THREE.Vector3 {
    return point.sub(this.centre).divideScalar(this.radius);
  }

  toField(point: THREE.Vector3): THREE.Vector3 {
    return point.multiplyScalar(this.radius).add(this.centre);
  }

  lengthToPage(length: number): number {
    return length / this.radius;
  }
}

/** A camera that the visitor moves. Cameras of fields have OpenCV axes, three.js has OpenGL's. */
export class Eye {
  readonly camera = new THREE.PerspectiveCamera(50, 1, 0.01, 1000);
  readonly controls: OrbitControls;
  /** The camera of the field that is looked through; null once the visitor has moved. */
  at: CameraRecord | null = null;
  onMove: () => void = () => {};
  readonly world: World;
  /** Of the camera that was flown to last: half the height of the picture at depth 1, and width by height. */
  private half = Math.tan(THREE.MathUtils.degToRad(25));
  private shape = 0;
  private flight = 0;
  private dragged = false;

  constructor(metadata: Metadata, element: HTMLElement) {
    this.world = new World(metadata);
    this.camera.near = 0.002;
    this.camera.far = 500;
    this.camera.up.set(...metadata.up);
    const aside = new THREE.Vector3(1, 0, 0).cross(this.camera.up);
    if (aside.length() < 0.1) aside.set(0, 1, 0).cross(this.camera.up);
    this.camera.position.copy(aside.normalize()).multiplyScalar(1.5);
    this.controls = new OrbitControls(this.camera, element);
    this.controls.enableDamping = false;
    this.controls.zoomToCursor = true;
    this.controls.update();
    this.controls.addEventListener("start", () => {
      this.flight += 1;
      this.dragged = true;
    });
    this.controls.addEventListener("end", () => {
      this.dragged = false;
    });
    this.controls.addEventListener("change", () => {
      if (this.dragged) this.at = null; // a click alone leaves the camera where it is
      this.onMove();
    });
  }

  /** The shape of the picture: all that the camera sees is in it, more beside or above it. */
  resize(width: number, height: number): void {
    this.camera.aspect = width / Math.max(1, height);
    this.fit();
  }

  private fit(): void {
    const half = this.half * Math.max(1, this.shape / this.camera.aspect);
    this.camera.fov = 2 * THREE.MathUtils.radToDeg(Math.atan(half));
    this.camera.updateProjectionMatrix();
  }

  /** Move to a camera of the field, in a flight unless the visitor wants no motion. */
  async flyTo(record: CameraRecord, flies: boolean): Promise<void> {
    this.land();
    const flight = this.flight;
    const { position, quaternion } = this.poseOf(record);
    const half = record.height / 2 / record.K[4];
    const shape = (record.width / record.height) * (record.K[4] / record.K[0]);
    const ahead = new THREE.Vector3(0, 0, -1).applyQuaternion(quaternion);
    const depth = Math.max(-position.dot(ahead), 0.1);
    const target = position.clone().addScaledVector(ahead, depth);
    const from = { position: this.camera.position.clone(), target: this.controls.target.clone(), half: this.half, shape: this.shape };
    const start = performance.now();
    for (let share = flies ? 0 : 1; ; ) {
      const eased = share * share * (3 - 2 * share);
      this.camera.position.lerpVectors(from.position, position, eased);
      this.controls.target.lerpVectors(from.target, target, eased);
      this.half = from.half + (half - from.half) * eased;
      this.shape = from.shape + (shape - from.shape) * eased;
      this.fit();
      this.controls.update();
      if (share >= 1) break;
      await new Promise(requestAnimationFrame);
      if (flight !== this.flight) return;
      share = Math.min(1, (performance.now() - start) / 1000 / FLIGHT_SECONDS);
    }
    // Exactly: orbiting keeps up as it is, and a camera of the field may be rolled.
    this.camera.quaternion.copy(quaternion);
    this.camera.updateMatrixWorld();
    this.at = record;
    this.onMove();
  }

  /** Move by keys: fractions of the distance to the target, right, up and ahead. */
  step(right: number, up: number, ahead: number): void {
    this.land();
    const distance = this.camera.position.distanceTo(this.controls.target) * STEP;
    const shift = new THREE.Vector3(right, up, 0).multiplyScalar(distance).applyQuaternion(this.camera.quaternion);
    const towards = this.controls.target.clone().sub(this.camera.position).multiplyScalar(ahead * STEP);
    this.camera.position.add(shift).add(towards);
    this.controls.target.add(shift);
    this.placed();
  }

  /** Turn around the target by keys, in radians. */
  turn(angle: number): void {
    this.land();
    const offset = this.camera.position.clone().sub(this.controls.target);
    offset.applyAxisAngle(this.camera.up, angle);
    this.camera.position.copy(this.controls.target).add(offset);
    this.placed();
  }

  /** Orbit around the depth of a point of the field from now on. */
  lookAround(place: number[]): void {
    const point = this.world.toPage(new THREE.Vector3().fromArray(place));
    const ahead = new THREE.Vector3();
    this.camera.getWorldDirection(ahead);
    const depth = point.sub(this.camera.position).dot(ahead);
    if (depth > 0) this.controls.target.copy(this.camera.position).addScaledVector(ahead, depth);
  }

  /** Look at a point of the field from the side of the nearest camera, and from so near that a size fills half of the picture. */
  async lookAt(place: number[], size: number, cameras: CameraRecord[]): Promise<void> {
    const point = this.world.toPage(new THREE.Vector3().fromArray(place));
    const distance = (record: CameraRecord) => this.poseOf(record).position.distanceTo(point);
    const nearest = cameras.reduce<CameraRecord | null>((best, each) => (best && distance(best) <= distance(each) ? best : each), null);
    if (nearest) await this.flyTo(nearest, false);
    this.land();
    const aside = this.camera.position.clone().sub(point).setLength(this.world.lengthToPage(size) / this.half);
    this.camera.position.copy(point).add(aside);
    this.controls.target.copy(point);
    this.placed();
  }

  /** The ray of a pixel of a picture of a size, in the world of the field. */
  ray(x: number, y: number, width: number, height: number): THREE.Ray {
    this.camera.updateMatrixWorld();
    const caster = new THREE.Raycaster();
    // The middle of the pixel, as on the server.
    caster.setFromCamera(new THREE.Vector2((2 * x + 1) / width - 1, 1 - (2 * y + 1) / height), this.camera);
    this.world.toField(caster.ray.origin);
    return caster.ray;
  }

  /** As the server takes it, for a picture of a size. */
  record(width: number, height: number): CameraRecord {
    this.camera.updateMatrixWorld();
    const place = this.world.toField(this.camera.position.clone());
    const pose = new THREE.Matrix4().compose(place, this.camera.quaternion, new THREE.Vector3(1, 1, 1));
    const flipped = new THREE.Matrix4().makeScale(1, -1, -1).multiply(pose.invert());
    const focal = height / 2 / Math.tan(THREE.MathUtils.degToRad(this.camera.fov) / 2);
    const K = [focal, 0, width / 2, 0, focal, height / 2, 0, 0, 1];
    return { name: this.at?.name ?? "", viewmat: flipped.transpose().toArray(), K, width, height };
  }

  /** Position in the page and OpenGL rotation of a camera of the field. */
  private poseOf(record: CameraRecord): { position: THREE.Vector3; quaternion: THREE.Quaternion } {
    const view = new THREE.Matrix4().fromArray(record.viewmat).transpose();
    const pose = view.invert().multiply(new THREE.Matrix4().makeScale(1, -1, -1));
    return {
      position: this.world.toPage(new THREE.Vector3().setFromMatrixPosition(pose)),
      quaternion: new THREE.Quaternion().setFromRotationMatrix(pose),
    };
  }

  private placed(): void {
    this.controls.update();
    this.onMove();
  }

  private land(): void {
    this.flight += 1;
    this.at = null;
  }
}
