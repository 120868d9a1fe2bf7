/**
 * Do something now, and again when `version` is another one than it was when it was done last, or it failed (`false`);
 * never twice at once, with a pause behind each time, until `ended`. However often the version changes, it is done.
 */
export async function whenChanged(
  version: () => string,
  act: () => Promise<boolean>,
  pauseMs: number,
  ended: AbortSignal,
): Promise<void> {
  let done: string | undefined;
  while (!ended.aborted) {
    const now = version();
    if (now !== done) done = (await act()) ? now : undefined;
    await new Promise((resolve) => setTimeout(resolve, pauseMs));
  }
}
