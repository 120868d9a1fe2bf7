/** Commands for a terminal. What agents and addresses say goes into them as words that a shell leaves alone. */

const PLAIN = /^[A-Za-z0-9_.,:=@%+/-]+$/;

/** A word as a shell takes it for one, whatever is in it. */
export const quoted = (word: string): string => (PLAIN.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`);

/** The command of these words. */
export const command = (...words: readonly string[]): string => words.map(quoted).join(" ");

/** The command that makes an MCAP file of a recording, in a folder of its name. */
export const exportCommand = (recording: string): string =>
  command("robotkube", "recording", "export", recording, `./${recording}`, "--format", "mcap");
