// What AsyncAPI's own parser finds in a document, as JSON: problems of severity error or warning.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";

const [, , modules, path] = process.argv;
const load = createRequire(`${modules}/`);
const { Parser } = load("@asyncapi/parser");
const { ProtoBuffSchemaParser } = load("@asyncapi/protobuf-schema-parser");

const parser = new Parser();
parser.registerSchemaParser(ProtoBuffSchemaParser());
const { document, diagnostics } = await parser.parse(readFileSync(path, "utf8"));
const problems = diagnostics
  .filter(({ severity }) => severity < 2)
  .map(({ path, message }) => `${path.join(".")}: ${message}`);
const examples = document?.allMessages().all().map((m) => [m.name(), m.examples().all().length]);
console.log(JSON.stringify({ problems, examples: examples ?? null }));
