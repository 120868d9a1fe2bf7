import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import { whenChanged } from "./changing";

beforeEach(() => void vi.useFakeTimers());
afterEach(() => void vi.useRealTimers());

describe("doing something when a version changes", () => {
  it("is done although the version changes faster than it may be done", async () => {
    const ended = new AbortController();
    let version = 0;
    const ticking = setInterval(() => (version += 1), 100);
    const act = vi.fn(() => Promise.resolve(true));
    void whenChanged(() => `${version}`, act, 1500, ended.signal);
    await vi.advanceTimersByTimeAsync(6100);
    expect(act).toHaveBeenCalledTimes(5);
    ended.abort();
    await vi.advanceTimersByTimeAsync(6000);
    expect(act).toHaveBeenCalledTimes(5);
    clearInterval(ticking);
  });

  it("is done once while nothing changes, and again after it failed", async () => {
    const ended = new AbortController();
    const act = vi.fn().mockResolvedValueOnce(false).mockResolvedValue(true);
    void whenChanged(() => "1", act, 1000, ended.signal);
    await vi.advanceTimersByTimeAsync(10_500);
    expect(act).toHaveBeenCalledTimes(2);
    ended.abort();
  });
});
