import { defineConfig } from "vitest/config";

// The process serves the page below whatever path it stands at, so addresses are relative; nothing is inlined, since the
// Content-Security-Policy allows neither inline scripts nor data addresses.
export default defineConfig({
  base: "./",
  build: { target: "es2022", assetsInlineLimit: 0, modulePreload: { polyfill: false }, reportCompressedSize: false },
  test: { environment: "node", include: ["src/**/*.test.ts"], isolate: false, watch: false },
});
