// Reads a recording with the readers of Foxglove, and compares every value with the CSV export of the same file:
//
//     hil run circle_speed --record run.mcap && hil review run.mcap --export run.csv
//     npm install --no-save @mcap/core @foxglove/rosmsg @foxglove/rosmsg2-serialization fzstd
//     node tools/foxglove/check_mcap.mjs run.mcap run.csv
//
// Needs Node 18 or later. It is run by hand: Foxglove decodes ros2msg with these packages, and the library that our own
// tests use (mcap-ros2-support) is another decoder by the authors of MCAP.

import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { join } from "node:path";

// Packages are looked for where the command is given, not beside this file.
const require = createRequire(join(process.cwd(), "package.json"));
const { McapIndexedReader, McapStreamReader } = require("@mcap/core");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");
const { decompress } = require("fzstd");

const decompressHandlers = { zstd: (data) => decompress(data) };
const problems = [];

function check(is_true, sentence) {
  if (!is_true) problems.push(sentence);
}

/** The leaves of a message by their dotted names. */
function leaves(message, prefix = "") {
  return Object.entries(message).flatMap(([name, value]) =>
    typeof value === "object" ? leaves(value, `${prefix}${name}.`) : [[prefix + name, value]],
  );
}

const [mcapPath, csvPath] = process.argv.slice(2);
if (csvPath === undefined) {
  console.error("usage: node check_mcap.mjs RUN.mcap RUN.csv");
  process.exit(2);
}
const bytes = new Uint8Array(await readFile(mcapPath));
const readable = {
  size: async () => BigInt(bytes.length),
  read: async (offset, size) => bytes.subarray(Number(offset), Number(offset + size)),
};
const [header, ...lines] = (await readFile(csvPath, "utf8")).trim().split("\n");
const names = header.split(",");
const table = lines.map((line) => line.split(",").map((text) => (text === "" ? NaN : Number(text))));

// By the index, as Foxglove opens a file.
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
const readers = new Map();
const counts = new Map();
const metadata = new Set();
let row = 0;
let last = 0n;
for await (const message of reader.readMessages()) {
  const channel = reader.channelsById.get(message.channelId);
  const schema = reader.schemasById.get(channel.schemaId);
  counts.set(channel.topic, (counts.get(channel.topic) ?? 0) + 1);
  check(message.logTime >= last, `${channel.topic}: a message at ${message.logTime} is out of order`);
  last = message.logTime;
  if (!readers.has(schema.id)) {
    const definitions = parse(new TextDecoder().decode(schema.data), { ros2: true });
    readers.set(schema.id, new MessageReader(definitions));
  }
  const decoded = readers.get(schema.id).readMessage(message.data);
  if (channel.topic === "/events") {
    check(schema.name === "rcl_interfaces/msg/Log" && decoded.msg.length > 0, "/events: no log");
    continue;
  }
  if (channel.topic === "/tf") {
    check(decoded.transforms.length > 0, "/tf: a message without transforms");
    continue;
  }
  if (channel.topic === "/robot_description") {
    check(decoded.data.includes("<robot "), "/robot_description: no URDF");
    continue;
  }
  const found = new Map(leaves(decoded));
  check(found.size === names.length, `row ${row}: ${found.size} values, the table has ${names.length}`);
  names.forEach((name, i) =>
    check(Object.is(found.get(name), table[row]?.[i]), `row ${row}, ${name}: ${found.get(name)}, not ${table[row]?.[i]}`),
  );
  row += 1;
}
for await (const record of reader.readMetadata()) metadata.add(record.name);
check(row === table.length, `${row} rows, the table has ${table.length}`);

// From the beginning, each chunk with its checksum: what the summary says must be what there is.
const stream = new McapStreamReader({ includeChunks: true, decompressHandlers, validateCrcs: true });
stream.append(bytes);
const records = new Map();
const streamed = new Map();
for (let record = stream.nextRecord(); record !== undefined; record = stream.nextRecord()) {
  records.set(record.type, (records.get(record.type) ?? 0) + 1);
  if (record.type === "Message") streamed.set(record.channelId, (streamed.get(record.channelId) ?? 0n) + 1n);
}
const said = reader.statistics;
check(said !== undefined, "there is no statistics record");
check(reader.chunkIndexes.length === records.get("Chunk"), "the index has not as many chunks as the file");
check(said?.chunkCount === records.get("Chunk"), "the statistics have not as many chunks as the file");
check(said?.metadataCount === metadata.size, "the index has not as many metadata records as the file");
for (const [id, count] of streamed) {
  check(said?.channelMessageCounts.get(id) === count, `channel ${id}: ${count} messages, not as the statistics say`);
}
for (const [topic, count] of counts) console.log(`${topic}: ${count} messages`);
console.log(`${names.length} values a row, ${reader.chunkIndexes.length} chunks, metadata ${[...metadata].join(", ")}`);
for (const sentence of problems.slice(0, 10)) console.error(sentence);
console.log(problems.length === 0 ? "all as exported" : `${problems.length} problems`);
process.exit(problems.length === 0 ? 0 : 1);
