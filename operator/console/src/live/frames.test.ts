import { describe, expect, it } from "vitest";
import { FrameReader, type Frame } from "./frames";

const STREAM = ': beat\n\nid: 7\nevent: change\ndata: {"a":1}\n\ndata: one\r\ndata: two\r\n\r\nid: 9\n\n';
const FRAMES: Frame[] = [
  { kind: "comment" },
  { kind: "event", id: "7", event: "change", data: '{"a":1}' },
  { kind: "event", id: "7", event: "message", data: "one\ntwo" },
];

describe("a stream of server-sent events", () => {
  it("is the same wherever it is cut", () => {
    for (let cut = 0; cut <= STREAM.length; cut += 1) {
      const reader = new FrameReader();
      expect([...reader.read(STREAM.slice(0, cut)), ...reader.read(STREAM.slice(cut))]).toEqual(FRAMES);
    }
  });

  it("keeps an unfinished event back", () => {
    const reader = new FrameReader();
    expect(reader.read("data: half\n")).toEqual([]);
    expect(reader.read("\n")).toHaveLength(1);
  });
});
