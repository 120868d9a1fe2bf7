import { describe, expect, it } from "vitest";
import { at, placeOf, why } from "./state";

describe("places in the page", () => {
  it("are found again, whatever their names", () => {
    expect(placeOf(at("fleet", "vehicle 7/ü%"))).toEqual(["fleet", "vehicle 7/ü%"]);
    expect(placeOf(why("task", "cloud-0/meeting"))).toEqual(["why", "task", "cloud-0", "meeting"]);
  });
  it("are the fleet where an address is broken", () => expect(placeOf("#/why/%E0%A4%A")).toEqual([]));
});
