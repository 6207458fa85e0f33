/** Tensors of JSON bodies: `{datatype, shape, raw}`, `raw` in base64, little-endian. */
import type { Image, Tensor } from "./types";

/** Returns the bytes of base64. */
export function fromBase64(text: string): Uint8Array<ArrayBuffer> {
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; i += 1) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

/** Returns bytes as base64. */
export function toBase64(bytes: Uint8Array): string {
  const parts: string[] = [];
  for (let i = 0; i < bytes.length; i += 0x8000) parts.push(String.fromCharCode(...bytes.subarray(i, i + 0x8000)));
  return btoa(parts.join(""));
}

/** Returns the elements of a tensor of FP32, FP64, INT64, INT32, UINT8 or BOOL as numbers, in C order. */
export function numbersOf(tensor: Tensor): number[] {
  const view = new DataView(fromBase64(tensor.raw).buffer);
  const size = { FP64: 8, INT64: 8, FP32: 4, INT32: 4, UINT32: 4, UINT16: 2 }[tensor.datatype as string] ?? 1;
  const read = (at: number): number => {
    if (tensor.datatype === "FP32") return view.getFloat32(at, true);
    if (tensor.datatype === "FP64") return view.getFloat64(at, true);
    if (tensor.datatype === "INT64") return Number(view.getBigInt64(at, true));
    if (tensor.datatype === "INT32") return view.getInt32(at, true);
    if (tensor.datatype === "UINT32") return view.getUint32(at, true);
    return tensor.datatype === "UINT16" ? view.getUint16(at, true) : view.getUint8(at);
  };
  return Array.from({ length: view.byteLength / size }, (_, index) => read(index * size));
}

/** Returns image `index` of a UINT8 tensor (N, H, W, C) as pixels for a canvas. */
export function pixelsOf(tensor: Tensor, index = 0): ImageData {
  const [, height = 1, width = 1, channels = 1] = tensor.shape;
  const size = height * width * channels;
  const bytes = fromBase64(tensor.raw).subarray(index * size, (index + 1) * size);
  const pixels = new ImageData(width, height);
  for (let i = 0; i < height * width; i += 1) {
    for (let c = 0; c < 3; c += 1) pixels.data[4 * i + c] = bytes[channels === 1 ? i : channels * i + c] ?? 0;
    pixels.data[4 * i + 3] = 255;
  }
  return pixels;
}

/** Returns the single image of a UINT8 tensor (1, H, W, C) as an image of a request. */
export function imageOf(tensor: Tensor, camera: string): Image {
  const [, height = 1, width = 1, channels = 1] = tensor.shape;
  return { encoding: channels === 1 ? "raw_gray8" : "raw_rgb8", height, width, data: tensor.raw, camera };
}
