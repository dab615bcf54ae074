// Prints each message of an MCAP file as one line of JSON: topic, log time, publish time, sequence, decoded message.
import { readFile } from "node:fs/promises";

import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import lz4 from "@foxglove/wasm-lz4";
import { McapIndexedReader, McapStreamReader } from "@mcap/core";

// JSON has no 64-bit integers, NaN or -0
function toJson(_key, value) {
  if (typeof value === "bigint") return { $int: value.toString() };
  if (ArrayBuffer.isView(value)) return Array.from(value);
  if (Object.is(value, -0)) return { $float: "-0.0" };
  if (typeof value === "number" && !Number.isFinite(value)) return { $float: String(value) };
  return value;
}

const data = await readFile(process.argv[2]);
await lz4.isLoaded;
const decompressHandlers = { lz4: (packed, size) => lz4(packed, Number(size)) };

// a finished file: by its summary
async function* readByIndex() {
  const readable = {
    size: async () => BigInt(data.length),
    read: async (offset, size) => new Uint8Array(data.subarray(Number(offset), Number(offset + size))),
  };
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  for await (const message of reader.readMessages({ validateCrcs: true })) {
    const channel = reader.channelsById.get(message.channelId);
    yield { message, channel, schema: reader.schemasById.get(channel.schemaId) };
  }
}

// an unfinished one: from its beginning for as long as whole records come
function* readFromTheStart() {
  const reader = new McapStreamReader({ decompressHandlers });
  const channels = new Map();
  const schemas = new Map();
  reader.append(data);
  for (let record; (record = reader.nextRecord()); ) {
    if (record.type === "Schema") schemas.set(record.id, record);
    if (record.type === "Channel") channels.set(record.id, record);
    if (record.type === "Message") {
      const channel = channels.get(record.channelId);
      yield { message: record, channel, schema: schemas.get(channel.schemaId) };
    }
  }
}

const decoders = new Map();
for await (const { message, channel, schema } of process.argv[3] === "unfinished" ? readFromTheStart() : readByIndex()) {
  if (!decoders.has(channel.id)) {
    decoders.set(channel.id, new MessageReader(parse(new TextDecoder().decode(schema.data), { ros2: true })));
  }
  const decoded = decoders.get(channel.id).readMessage(message.data);
  const line = [channel.topic, message.logTime, message.publishTime, message.sequence, decoded];
  process.stdout.write(JSON.stringify(line, toJson) + "\n");
}
