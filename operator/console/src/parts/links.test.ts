import { describe, expect, it } from "vitest";
import type { Link } from "../live/model";
import { argocdPage, linkRate, linksInWords, linkWords, policiesPage } from "./links";

const LINK: Link = {
  release: "vehicle-00/mqtt-bridge",
  agent: "vehicle-00",
  direction: "out",
  topic: "/pose",
  rate_hz: 10,
  over_seconds: 5,
  silent_since_ms: null,
  latency_ms: null,
  matched: 1,
  problem: "",
};

describe("links", () => {
  it("say their rate, or that it is not known", () => {
    const rates = [10, 0, null].map((rate_hz) => linkRate({ ...LINK, rate_hz }));
    expect(rates).toEqual(["10 Hz", "silent", "not known"]);
    expect(linkRate({ ...LINK, direction: "" })).toBe("not carried");
  });
  it("say since when they are silent, and why nothing is known", () => {
    expect(linkWords({ ...LINK, rate_hz: 0, silent_since_ms: 40_000, matched: 0 }, 100_000)).toMatch(
      /^no message since .* \(1 min\); nobody publishes it$/,
    );
    expect(linkWords({ ...LINK, rate_hz: null }, 0)).toBe("a rate needs two readings");
    expect(linkWords({ ...LINK, rate_hz: null, problem: "no answer" }, 0)).toBe("no answer");
  });
  it("are counted for an agent", () => {
    expect(linksInWords([])).toBe("");
    const links: Link[] = [LINK, { ...LINK, rate_hz: 0 }, { ...LINK, rate_hz: null }, { ...LINK, direction: "" }];
    expect(linksInWords(links)).toBe("3 links, 10 messages/s, 1 silent, 1 not known, 1 not carried");
  });
});

describe("Argo CD's page of an Application", () => {
  it("is below the address of its pages, where there is one", () => {
    expect(argocdPage("https://argocd.example.com/", "cloud-0-recorder")).toBe(
      "https://argocd.example.com/applications/cloud-0-recorder",
    );
    expect(argocdPage("", "cloud-0-recorder")).toBe("");
  });
});

describe("the policies on the forge", () => {
  it("are in the repository of any plan, else somewhere on the forge", () => {
    const requests = ["", "https://git.example.com/robotkube/deployment/pulls/12"];
    expect(policiesPage(requests, "https://git.example.com")).toBe(
      "https://git.example.com/robotkube/deployment/src/branch/main/policies",
    );
    expect(policiesPage([""], "https://git.example.com")).toBe("https://git.example.com");
    expect(policiesPage([], "")).toBe("");
  });
});
