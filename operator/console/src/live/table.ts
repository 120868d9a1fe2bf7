import { KINDS, type Change, type Item, type Items, type Kind, type Snapshot } from "./model";

type Maps = { readonly [K in Kind]: Map<string, Item<K>> };

/**
 * The table of items as the process has it at one version. A change applies to the version before it alone: one that is
 * not newer than the table was applied already. `changed` counts the changes of each kind, so that a view knows whether
 * to look again.
 */
export class Table {
  id = "";
  version = -1;
  links: Snapshot["links"] = { forge: "", argocd: "" };
  readonly maps: Maps = {
    agents: new Map(),
    poses: new Map(),
    tasks: new Map(),
    plans: new Map(),
    releases: new Map(),
    pods: new Map(),
    events: new Map(),
    rules: new Map(),
    catalogue: new Map(),
    strangers: new Map(),
    unchecked: new Map(),
    certificates: new Map(),
    links: new Map(),
    recordings: new Map(),
    sources: new Map(),
  };
  readonly changed = new Map<Kind, number>();

  /** Begin anew with a snapshot. */
  replace(snapshot: Snapshot): void {
    this.id = snapshot.id;
    this.version = snapshot.version;
    this.links = snapshot.links;
    for (const kind of KINDS) {
      this.maps[kind].clear();
      this.put(kind, snapshot.items);
      this.touch(kind);
    }
  }

  /** Apply a change; returns whether it was new. */
  apply(change: Change): boolean {
    if (change.version <= this.version) return false;
    for (const kind of KINDS) {
      const gone = change.gone[kind] ?? [];
      for (const key of gone) this.maps[kind].delete(key);
      if (this.put(kind, change.set) || gone.length) this.touch(kind);
    }
    this.id = change.id;
    this.version = change.version;
    return true;
  }

  private put<K extends Kind>(kind: K, items: Items): boolean {
    const entries = Object.entries(items[kind] ?? {}) as [string, Item<K>][];
    const map = this.maps[kind] as Map<string, Item<K>>;
    for (const [key, item] of entries) map.set(key, item);
    return entries.length > 0;
  }

  private touch(kind: Kind): void {
    this.changed.set(kind, (this.changed.get(kind) ?? 0) + 1);
  }
}
