import type { Chain, Change, Explanation, Problem, Session, Snapshot, TaskRequest, WhyKind } from "./model";

/** The process refused, or did not answer (status 0). `detail` says why and what to do, in words. */
export class Refused extends Error {
  constructor(
    readonly status: number,
    readonly title: string,
    detail: string,
    readonly signIn: string | undefined,
  ) {
    super(detail);
  }
}

const ANSWER_MS_MAX = 20_000;
const AWAY = "The console's process does not answer. Look at the pod of component console, or at the way to it.";

/** A document of the process. Addresses are relative to the page, which may stand at any path. */
export async function read<T>(path: string, signal?: AbortSignal): Promise<T> {
  return documentIn<T>(await asked(path, { signal: either(signal, AbortSignal.timeout(ANSWER_MS_MAX)) }));
}

async function documentIn<T>(answer: Response): Promise<T> {
  return (await answer.json().catch(() => {
    throw new Refused(0, "No answer", AWAY, undefined);
  })) as T;
}

export const readSession = (): Promise<Session> => read<Session>("api/session");
export const readSnapshot = (signal: AbortSignal): Promise<Snapshot> => read<Snapshot>("api/snapshot", signal);
export const readChange = (after: string, signal: AbortSignal): Promise<Change> =>
  read<Change>(`api/changes?after=${encodeURIComponent(after)}`, signal);

export function readChain(kind: WhyKind, id: string, signal: AbortSignal): Promise<Chain> {
  const escaped = id.split("/").map(encodeURIComponent).join("/");
  return read<Chain>(`api/why/${kind}/${escaped}`, signal);
}

/** The stream of events after an id; its pieces of text as they come. */
export async function openStream(after: string, signal: AbortSignal): Promise<ReadableStreamDefaultReader<string>> {
  const headers = { Accept: "text/event-stream" };
  const answer = await asked(`api/events?after=${encodeURIComponent(after)}`, { signal, headers, cache: "no-store" });
  if (!answer.body) throw new Refused(0, "No answer", AWAY, undefined);
  return answer.body.pipeThrough(new TextDecoderStream()).getReader();
}

/** What would become of a task, or of everything else without the task of a key. Nothing changes. */
export const explain = (question: TaskRequest | { withdraw: string }, csrf: string): Promise<Explanation> =>
  write<Explanation>("POST", "api/explain", csrf, question);

/** Ask for an application; the task's key. */
export const submitTask = (request: TaskRequest, csrf: string): Promise<{ task: string }> =>
  write<{ task: string }>("POST", "api/tasks", csrf, request);

/** Take a task back. */
export async function withdrawTask(key: string, csrf: string): Promise<void> {
  const path = `api/tasks/${key.split("/").map(encodeURIComponent).join("/")}`;
  await asked(path, {
    method: "DELETE",
    headers: { "X-CSRF-Token": csrf },
    signal: AbortSignal.timeout(ANSWER_MS_MAX),
  });
}

async function write<T>(method: string, path: string, csrf: string, document: unknown): Promise<T> {
  const headers = { "Content-Type": "application/json", "X-CSRF-Token": csrf };
  const signal = AbortSignal.timeout(ANSWER_MS_MAX);
  return documentIn<T>(await asked(path, { method, headers, body: JSON.stringify(document), signal }));
}

/** End the session. */
export async function signOut(csrf: string): Promise<void> {
  await asked("auth/logout", { method: "POST", headers: { "X-CSRF-Token": csrf } });
}

async function asked(path: string, init: RequestInit): Promise<Response> {
  let answer: Response;
  try {
    answer = await fetch(path, { credentials: "same-origin", ...init });
  } catch (error) {
    throw new Refused(0, "No answer", AWAY, undefined);
  }
  if (!answer.ok) throw await refusal(answer);
  return answer;
}

async function refusal(answer: Response): Promise<Refused> {
  const problem = (await answer.json().catch(() => ({}))) as Partial<Problem>;
  const title = problem.title ?? `HTTP ${answer.status}`;
  return new Refused(answer.status, title, problem.detail ?? AWAY, problem.sign_in);
}

function either(first: AbortSignal | undefined, second: AbortSignal): AbortSignal {
  return first ? AbortSignal.any([first, second]) : second;
}
