const DRIFT = 0.01;

/**
 * The process's clock, guessed in the browser: what it says with each message, by the message that was under way for the
 * shortest time. A slow message moves the guess only a little, so that a clock that was set is followed all the same.
 */
export class ProcessClock {
  private offset: number | undefined;

  constructor(private readonly own: () => number) {}

  /** A message says what time it is. */
  heard(time: number): void {
    const offset = time - this.own();
    this.offset =
      this.offset === undefined || offset > this.offset ? offset : this.offset + (offset - this.offset) * DRIFT;
  }

  now(): number {
    return this.own() + (this.offset ?? 0);
  }
}
