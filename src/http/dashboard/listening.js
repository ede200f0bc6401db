// Plays a record as sound, normalised to one peak level, so the loudness carries no information.

import * as api from "./api.js";

const MAX_SECONDS = 30;
const PIECE = 190_000; // samples of one response
const PEAK = 0.9;
const RATES = [3000, 768_000]; // sampling rates that browsers accept for a buffer

/** The playback speeds. */
export const SPEEDS = [0.25, 0.5, 1, 2, 4, 8];

/** The samples of a record, or of the start of a long one. */
async function samplesOf({ id, samples, sample_rate_hz: rate }, signal) {
  const count = Math.min(samples, Math.floor(MAX_SECONDS * rate));
  const values = new Float32Array(count);
  for (let first = 0; first < count; first += PIECE) {
    const last = Math.min(first + PIECE, count);
    const piece = await api.samples(id, (first + 0.5) / rate, (last - 0.5) / rate, signal);
    const from = Math.round(piece.time_s[0] * rate);
    piece.value.forEach((value, n) => {
      if (from + n < count) values[from + n] = value;
    });
  }
  return values;
}

/** Samples without their mean, scaled to a set peak. */
export function normalised(values) {
  const mean = values.reduce((sum, value) => sum + value, 0) / (values.length || 1);
  const peak = values.reduce((most, value) => Math.max(most, Math.abs(value - mean)), 0) || 1;
  return values.map((value) => ((value - mean) * PEAK) / peak);
}

/** Plays one record at a time in a loop; `onChange(id)` reports which one is playing, null for none. */
export class Listening {
  #context;
  #source;
  #asked = null;
  #speed = 1;
  #onChange;

  constructor(onChange) {
    this.#onChange = onChange;
  }

  /** The record being played. */
  get id() {
    return this.#asked?.id ?? null;
  }

  /** Sets the playback speed. */
  set speed(times) {
    this.#speed = times;
    if (this.#source) this.#source.playbackRate.value = times * this.#source.stretch;
  }

  /** Plays a record. */
  async play(segment) {
    this.stop();
    const asked = { id: segment.id, control: new AbortController() };
    this.#asked = asked;
    this.#onChange(segment.id);
    this.#context ??= new AudioContext();
    await this.#context.resume();
    try {
      const values = normalised(await samplesOf(segment, asked.control.signal));
      if (this.#asked !== asked) return;
      const own = segment.sample_rate_hz;
      const rate = Math.min(Math.max(own, RATES[0]), RATES[1]);
      const buffer = this.#context.createBuffer(1, Math.max(1, values.length), rate);
      buffer.copyToChannel(values, 0);
      const source = this.#context.createBufferSource();
      const stretch = own / rate; // a rate that browsers do not accept is compensated by the playback speed
      this.#source = Object.assign(source, { buffer, loop: true, stretch });
      source.playbackRate.value = this.#speed * stretch;
      source.connect(this.#context.destination);
      source.start();
    } catch (error) {
      if (this.#asked === asked) this.stop();
      if (error.name !== "AbortError") throw error;
    }
  }

  /** Stops playback. */
  stop() {
    this.#source?.stop();
    this.#source = undefined;
    this.#asked?.control.abort();
    if (this.#asked) {
      this.#asked = null;
      this.#onChange(null);
    }
  }

  /** Releases the audio resources. */
  dispose() {
    this.stop();
    this.#context?.close();
  }
}
