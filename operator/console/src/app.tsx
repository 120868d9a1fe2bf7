import type { FunctionComponent } from "preact";
import { useEffect, useState } from "preact/hooks";
import { readSession, signOut } from "./live/api";
import type { Session } from "./live/model";
import { Guarded } from "./parts/Guarded";
import { Words } from "./parts/parts";
import { Status } from "./parts/Status";
import { at, live, SessionContext, useConnection, useItems, useNow, usePlace } from "./state";
import { taskGroup } from "./parts/states";
import { clock } from "./words";
import { Agents } from "./views/Agents";
import { Catalogue } from "./views/Catalogue";
import { Fleet } from "./views/Fleet";
import { Plans } from "./views/Plans";
import { Recordings } from "./views/Recordings";
import { Sources } from "./views/Sources";
import { Tasks } from "./views/Tasks";
import { Trust } from "./views/Trust";
import { Why } from "./views/Why";

const VIEWS: Record<string, readonly [string, FunctionComponent]> = {
  fleet: ["Fleet", Fleet],
  tasks: ["Tasks", Tasks],
  plans: ["Plans", Plans],
  recordings: ["Recordings", Recordings],
  agents: ["Agents", Agents],
  catalogue: ["Catalogue", Catalogue],
  trust: ["Trust", Trust],
};
const BESIDE: Record<string, readonly [string, FunctionComponent]> = {
  why: ["Why", Why],
  sources: ["Sources", Sources],
};

/** The page: where one is, whether it is live, and the view. */
export function App() {
  const [session, set] = useState<Session>();
  const [place = "fleet"] = usePlace();
  const connection = useConnection();
  const answers = connection.mode === "live" || connection.mode === "polling";
  useEffect(() => {
    // Who asked while the process was away asks again when it answers.
    if (!session) readSession().then(set, () => undefined);
  }, [answers]);
  useShortcuts();
  const [title, View] = VIEWS[place] ?? BESIDE[place] ?? ["Fleet", Fleet];
  useEffect(() => {
    document.title = `${title} · RobotKube`;
  }, [title]);
  const refused = connection.mode === "signed-out" || connection.mode === "forbidden";
  return (
    <SessionContext.Provider value={session}>
      <a class="skip" href="#main" onClick={skip}>
        To the content
      </a>
      <header>
        <a class="brand" href={at("fleet")}>
          RobotKube
        </a>
        <Navigation place={place in VIEWS || place in BESIDE ? place : "fleet"} />
        <Status />
        <Person session={session} />
      </header>
      {connection.mode === "away" && <Away />}
      <Guarded key={place} name={title}>
        {refused ? <NotAllowed session={session} /> : live.heardAt ? <View /> : <Starting />}
      </Guarded>
    </SessionContext.Provider>
  );
}

function Navigation({ place }: { place: string }) {
  const waiting = [...useItems("tasks").values()].filter((task) => taskGroup(task) === "waiting").length;
  const past = [...useItems("unchecked").values()].filter((commit) => !commit.made_good).length;
  const trouble = useItems("strangers").size + past;
  const numbers: Record<string, [number, string]> = {
    tasks: [waiting, "wait"],
    trust: [trouble, "strangers and commits past the gate"],
  };
  return (
    <nav aria-label="Views">
      {Object.entries(VIEWS).map(([name, [title]]) => {
        const [number, word] = numbers[name] ?? [0, ""];
        return (
          <a key={name} href={at(name)} aria-current={name === place ? "page" : undefined}>
            {title}
            {number > 0 && (
              <span class="number">
                {number}
                <span class="hidden"> {word}</span>
              </span>
            )}
          </a>
        );
      })}
    </nav>
  );
}

function Person({ session }: { session: Session | undefined }) {
  if (!session?.user) return null;
  const { csrf } = session;
  const leave = (): void => {
    if (csrf) signOut(csrf).then(() => location.reload());
  };
  return (
    <span class="person">
      {session.user}{" "}
      {session.sign_in && (
        <button type="button" onClick={leave}>
          Sign out
        </button>
      )}
    </span>
  );
}

function Starting() {
  return (
    <main id="main">
      <h1>The fleet</h1>
      <p role="status">The platform is being read …</p>
    </main>
  );
}

/** What stands on the page stays, as of when it was read. */
function Away() {
  const connection = useConnection();
  const now = useNow();
  return (
    <div class="note bad" role="alert">
      <strong>Not connected{live.heardAt ? `; what is shown is as of ${clock(live.heardAt, now)}` : ""}.</strong>{" "}
      <Words text={connection.problem} /> The page tries again by itself.
    </div>
  );
}

function NotAllowed({ session }: { session: Session | undefined }) {
  const connection = useConnection();
  const signIn = live.signIn ?? session?.sign_in ?? undefined;
  const back = `${location.pathname}${location.hash}`;
  return (
    <main id="main" class="door">
      <h1>{connection.mode === "signed-out" ? "Sign in to see the fleet" : "You may not read this"}</h1>
      <p>
        <Words text={connection.problem || (session?.why_not ?? "")} />
      </p>
      {connection.mode === "forbidden" && session?.user && (
        <p>
          You are {session.user}
          {session.groups.length ? `, of ${session.groups.join(", ")}` : ", of no group"}. Who runs the platform can add
          you to a group that may read.
        </p>
      )}
      {signIn && connection.mode === "signed-out" && (
        <p>
          <a class="button" href={`${signIn}?back=${encodeURIComponent(back)}`}>
            Sign in
          </a>
        </p>
      )}
    </main>
  );
}

function skip(event: Event): void {
  event.preventDefault();
  const main = document.getElementById("main");
  main?.setAttribute("tabindex", "-1");
  main?.focus();
}

/** The key `/` leads to the view's search. */
function useShortcuts(): void {
  useEffect(() => {
    const typed = (event: KeyboardEvent): void => {
      const within = event.target instanceof HTMLElement && event.target.closest("input, textarea, select");
      if (event.key !== "/" || within || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      document.querySelector<HTMLElement>("[data-search]")?.focus();
    };
    addEventListener("keydown", typed);
    return () => removeEventListener("keydown", typed);
  }, []);
}
