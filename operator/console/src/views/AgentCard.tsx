import type { Pod, Release } from "../live/model";
import { silentSince } from "../map/fleet";
import { linkRate, linkTone, linkWords } from "../parts/links";
import { Badge, Empty } from "../parts/parts";
import { sharedWords } from "../parts/sharing";
import { releaseTone } from "../parts/states";
import { useItems, why } from "../state";
import { age, ago, clock } from "../words";
import { Hold } from "./Fleet";

const DEGREES = 180 / Math.PI;

/** One agent: where it is, since when it is silent, what runs on it and for whom. */
export function AgentCard({ name, now, close }: { name: string; now: number; close: () => void }) {
  const agent = useItems("agents").get(name);
  const pose = useItems("poses").get(name);
  const silent = silentSince(agent, pose, now);
  const namespace = agent?.namespace ?? name;
  return (
    <section class="card" aria-labelledby="agent-head">
      <button type="button" class="close" aria-label={`Close ${name}`} onClick={close}>
        ×
      </button>
      <h2 id="agent-head">{name}</h2>
      {!agent && !pose && <Empty title="Nobody of this name is declared or heard (any more)." />}
      {silent !== undefined && (
        <p class="bad">
          Silent since {clock(silent, now)} ({age(silent, now)}); what is below is as of then.
        </p>
      )}
      <dl>
        {agent && (
          <>
            <dt>Role</dt>
            <dd>{[agent.role, ...agent.capabilities].filter(Boolean).join(", ") || "none"}</dd>
            <dt>Nodes</dt>
            <dd>
              {agent.nodes
                .map((node) => `${node.name}${node.ready ? "" : " (not ready)"}${node.cordoned ? " (cordoned)" : ""}`)
                .join(", ") || "none joined"}
              {agent.nodes
                .filter((node) => node.shared_with.length)
                .map((node) => (
                  <div key={node.name} class="quiet">
                    {sharedWords(node)}
                  </div>
                ))}
            </dd>
            <dt>Hold</dt>
            <dd>
              <Hold agent={agent} now={now} />
            </dd>
          </>
        )}
        <dt>Position</dt>
        <dd>
          {pose ? (
            <>
              {pose.x.toFixed(1)} m, {pose.y.toFixed(1)} m
              {pose.heading !== null && `, heading ${Math.round(pose.heading * DEGREES)}°`}
              <span class="quiet"> {ago(pose.received_ms, now)}</span>
            </>
          ) : (
            <span class="quiet">none was heard</span>
          )}
        </dd>
      </dl>
      <Links namespace={namespace} now={now} />
      <Running namespace={namespace} />
    </section>
  );
}

function Links({ namespace, now }: { namespace: string; now: number }) {
  const links = [...useItems("links")].filter(([, link]) => link.agent === namespace);
  if (!links.length) return <p class="quiet">No link is known: no bridge runs here, or none was read yet.</p>;
  return (
    <>
      <h3>Links to the broker</h3>
      <ul class="runs">
        {links.map(([key, link]) => (
          <li key={key}>
            <span class="way">{WAYS[link.direction]}</span> <code>{link.topic || link.release}</code>
            <div>
              <Badge tone={linkTone(link)}>{linkRate(link)}</Badge> <span class="quiet">{linkWords(link, now)}</span>
            </div>
          </li>
        ))}
      </ul>
    </>
  );
}

const WAYS = { out: "out", in: "in", "": "not carried" };

function Running({ namespace }: { namespace: string }) {
  const releases = [...useItems("releases")].filter(([, release]) => release.agent === namespace);
  const pods = [...useItems("pods")].filter(([, pod]) => pod.namespace === namespace);
  if (!releases.length) return <p class="quiet">No release is deployed here.</p>;
  return (
    <>
      <h3>Runs here</h3>
      <ul class="runs">
        {releases.map(([key, release]) => (
          <li key={key}>
            <a href={why("release", key)}>
              <span class="name">{release.release}</span>
            </a>{" "}
            <Badge tone={releaseTone(release)}>{`${release.health} ${release.sync}`}</Badge>
            <div class="quiet">
              {release.chart}
              <For release={release} />
            </div>
            {pods
              .filter(([, pod]) => pod.release === release.release)
              .map(([podKey, pod]) => (
                <PodLine key={podKey} name={podKey} pod={pod} />
              ))}
          </li>
        ))}
      </ul>
    </>
  );
}

function For({ release }: { release: Release }) {
  if (!release.demands.length) return <>, of the initial configuration</>;
  return (
    <>
      , for{" "}
      {release.demands.map((task, index) => (
        <span key={task}>
          {index > 0 && ", "}
          <a href={why("task", task)}>{task}</a>
        </span>
      ))}
    </>
  );
}

function PodLine({ name, pod }: { name: string; pod: Pod }) {
  const words = [pod.deleting ? "is being removed" : pod.phase, pod.ready ? "" : "not ready"];
  if (pod.restarts) words.push(`${pod.restarts} restarts`);
  return (
    <div>
      <a href={why("pod", name)}>{pod.name}</a> <span class="quiet">{words.filter(Boolean).join(", ")}</span>
      {pod.trouble && <div class="bad">{pod.trouble}</div>}
    </div>
  );
}
