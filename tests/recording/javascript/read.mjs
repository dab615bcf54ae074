// Prints each message of an MCAP file as one line of JSON: topic, log time, publish time, sequence, decoded message.
import { readFile } from "node:fs/promises";

import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import lz4 from "@foxglove/wasm-lz4";
import { McapIndexedReader } from "@mcap/core";

// JSON has no 64-bit integers, NaN or -0
function toJson(_key, value) {
  if (typeof value === "bigint") return { $int: value.toString() };
  if (ArrayBuffer.isView(value)) return Array.from(value);
  if (Object.is(value, -0)) return { $float: "-0.0" };
  if (typeof value === "number" && !Number.isFinite(value)) return { $float: String(value) };
  return value;
}

const data = await readFile(process.argv[2]);
const readable = {
  size: async () => BigInt(data.length),
  read: async (offset, size) => new Uint8Array(data.subarray(Number(offset), Number(offset + size))),
};
await lz4.isLoaded;
const reader = await McapIndexedReader.Initialize({
  readable,
  decompressHandlers: { lz4: (packed, size) => lz4(packed, Number(size)) },
});
const decoders = new Map();
for await (const message of reader.readMessages({ validateCrcs: true })) {
  const channel = reader.channelsById.get(message.channelId);
  if (!decoders.has(channel.id)) {
    const schema = reader.schemasById.get(channel.schemaId);
    decoders.set(channel.id, new MessageReader(parse(new TextDecoder().decode(schema.data), { ros2: true })));
  }
  const decoded = decoders.get(channel.id).readMessage(message.data);
  const line = [channel.topic, message.logTime, message.publishTime, message.sequence, decoded];
  process.stdout.write(JSON.stringify(line, toJson) + "\n");
}
