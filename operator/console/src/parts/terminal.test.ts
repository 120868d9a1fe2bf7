import { describe, expect, it } from "vitest";
import { command, exportCommand } from "./terminal";

describe("commands for a terminal", () => {
  it("have plain words as they are", () => {
    expect(exportCommand("encounter-3f2a9c")).toBe(
      "robotkube recording export encounter-3f2a9c ./encounter-3f2a9c --format mcap",
    );
  });
  it("let nothing that an agent says be a command of its own", () => {
    expect(command("a", "b; rm -rf ~", "$(c)", "d'e", "")).toBe("a 'b; rm -rf ~' '$(c)' 'd'\\''e' ''");
    expect(exportCommand("x\nreboot")).toContain("'x\nreboot'");
  });
});
