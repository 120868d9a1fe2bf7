/** What the parts of the page share: the live table, the place in the page, the session. */
import { createContext } from "preact";
import { useContext, useEffect, useLayoutEffect, useReducer, useRef, useState } from "preact/hooks";
import { Live } from "./live/live";
import type { Item, Kind, Session, WhyKind } from "./live/model";
import { tracksOf } from "./map/fleet";

export const live = new Live();
export const tracks = tracksOf(live);

export const SessionContext = createContext<Session | undefined>(undefined);
export const useSession = (): Session | undefined => useContext(SessionContext);

const SECOND_MS = 1000;

/** Draw again when `signature` is another than it was when this was drawn. Looked at once per frame at most. */
export function useSignature(signature: () => string): void {
  const [, draw] = useReducer<number, void>((times) => times + 1, 0);
  const drawn = useRef({ signature, value: "" });
  drawn.current = { signature, value: signature() };
  useEffect(() => {
    let frame = 0;
    const look = (): void => {
      frame = 0;
      if (drawn.current.signature() !== drawn.current.value) draw();
    };
    const end = live.listen(() => {
      frame ||= requestAnimationFrame(look);
    });
    look();
    return () => {
      end();
      cancelAnimationFrame(frame);
    };
  }, []);
}

/** The items of a kind by key, drawn again when they change. */
export function useItems<K extends Kind>(kind: K): ReadonlyMap<string, Item<K>> {
  useSignature(() => `${live.table.changed.get(kind) ?? 0}`);
  return live.table.maps[kind] as ReadonlyMap<string, Item<K>>;
}

/** The connection, drawn again when it changes, or something is heard for the first time. */
export function useConnection(): Live["connection"] {
  useSignature(() => `${live.connection.mode} ${live.heardAt > 0} ${live.connection.problem}`);
  return live.connection;
}

/** The process's time in milliseconds, once a second. */
export function useNow(): number {
  const [now, set] = useState(live.now());
  useEffect(() => {
    const timer = setInterval(() => set(live.now()), SECOND_MS);
    return () => clearInterval(timer);
  }, []);
  return now;
}

/**
 * The place in the page: the words behind `#/`. It listens before the view is painted: who is quick, as a browser that
 * has much to do lets people be, moves on before an effect would have begun.
 */
export function usePlace(): readonly string[] {
  const [place, set] = useState(placeOf(location.hash));
  useLayoutEffect(() => {
    const moved = (): void => set(placeOf(location.hash));
    addEventListener("hashchange", moved);
    return () => removeEventListener("hashchange", moved);
  }, []);
  return place;
}

/** The words of an address; what is no address of the page is the fleet's. */
export function placeOf(hash: string): readonly string[] {
  try {
    return hash.replace(/^#\/?/, "").split("/").filter(Boolean).map(decodeURIComponent);
  } catch {
    return [];
  }
}

/** The address of a place in the page. */
export const at = (...words: readonly string[]): string => `#/${words.map(encodeURIComponent).join("/")}`;

/** The address of a chain. */
export const why = (kind: WhyKind, id: string): string => at("why", kind, ...id.split("/"));

export const go = (address: string): void => {
  location.hash = address;
};
