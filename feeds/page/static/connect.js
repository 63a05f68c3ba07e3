// Connect here: where the chosen sensor's messages are in this session, and lines to copy that receive them.

import { byId, element } from "./common.js";

const quoted = (words) => `'${words.replaceAll("'", `'\\''`)}'`;
const LEAVES_MS = 2500; // for which it is said that something was copied

/** {host, port, scheme} of a broker's address. */
function parts({ url }) {
  const { protocol, hostname, port } = new URL(url.replace(/^mqtt/, "http").replace(/^ws/, "http")); // a special scheme, so that hosts are read
  return { host: hostname.replace(/^\[|\]$/g, ""), port: port || (protocol === "https:" ? "8883" : "1883"), secure: protocol === "https:" };
}

function ofMosquitto(broker, topic, isText) {
  const { host, port, secure } = parts(broker), version = broker.protocol.endsWith("3.1.1") ? "mqttv311" : "mqttv5";
  const more = `${secure ? " --tls-use-os-certs" : ""}${broker.needs_password ? " -u USER -P PASSWORD" : ""}`;
  return `mosquitto_sub -h ${host} -p ${port} -V ${version}${more} -t ${quoted(topic)} -F ${isText ? "'%t %p'" : "'%t %x'"}`;
}

function ofPaho(broker, topic) {
  const { host, port, secure } = parts(broker), version = broker.protocol.endsWith("3.1.1") ? "MQTTv311" : "MQTTv5";
  return `# pip install paho-mqtt
import paho.mqtt.client as mqtt

def received(client, userdata, message):
    print(message.topic, len(message.payload), "octets:", message.payload[:24].hex(), flush=True)

client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, protocol=mqtt.${version})
client.on_connect = lambda client, *_: client.subscribe(${JSON.stringify(topic)})
client.on_message = received
${broker.needs_password ? 'client.username_pw_set("USER", "PASSWORD")\n' : ""}${secure ? "client.tls_set()\n" : ""}client.connect(${JSON.stringify(host)}, ${port})
client.loop_forever()`;
}

function ofAiomqtt(broker, topic) {
  const { host, port, secure } = parts(broker), version = broker.protocol.endsWith("3.1.1") ? "V311" : "V5";
  return `# pip install aiomqtt
import asyncio
import aiomqtt

async def main():
    async with aiomqtt.Client(${JSON.stringify(host)}, ${port}, protocol=aiomqtt.ProtocolVersion.${version}${broker.needs_password ? ', username="USER", password="PASSWORD"' : ""}${secure ? ", tls_params=aiomqtt.TLSParameters()" : ""}) as client:
        await client.subscribe(${JSON.stringify(topic)})
        async for message in client.messages:
            print(message.topic, len(message.payload), "octets:", message.payload[:24].hex(), flush=True)

asyncio.run(main())`;
}

function ofUdp({ destination, is_multicast: isMulticast, interface: by }) {
  const at = destination.lastIndexOf(":"), port = destination.slice(at + 1), host = destination.slice(0, at).replace(/^\[|\]$/g, "").split("%")[0];
  const family = host.includes(":") ? "6" : "4";
  if (!isMulticast) return `nc -${family} -u -l -p ${port} | xxd    # on ${host}`;
  const join = family === "4" ? `ip-add-membership=${host}:${by ?? "0.0.0.0"}` : `ipv6-join-group=[${host}]:${by ?? "eth0"}`;
  return `socat -u UDP${family}-RECV:${port},reuseaddr,${join} - | xxd`;
}

/** What there is to copy: [title, words]. */
function snippets({ brokers = [], sensors = {} }, id) {
  const { topics = [], udp = [] } = sensors[id] ?? {}, found = [];
  const mqtt = brokers.filter(({ url }) => url.startsWith("mqtt")), first = topics[0];
  if (first) {
    const isText = /json|text/.test(first.content_type);
    for (const broker of mqtt) found.push([`${broker.protocol}, a shell`, ofMosquitto(broker, first.topic, isText)]);
    if (mqtt.length) found.push(["Python, paho", ofPaho(mqtt[0], first.topic)], ["Python, aiomqtt", ofAiomqtt(mqtt[0], first.topic)]);
  }
  for (const to of udp) found.push([`UDP ${to.destination} (${to.carries === "asterix" ? "ASTERIX" : to.carries})`, ofUdp(to)]);
  return found;
}

/** Show them of a sensor. */
export function showConnections(news, id) {
  const told = news.connect ?? {}, { topics = [] } = told.sensors?.[id] ?? {};
  byId("connect-of").textContent = id ? `Messages of ${id}:` : "No sensor is chosen.";
  const rows = [
    ...(told.brokers ?? []).map(({ protocol, url }) => [protocol, url]),
    ...topics.map(({ topic, format }) => [format, topic]),
  ];
  byId("connect-where").replaceChildren(...rows.flatMap(([name, where]) => [element("dt", name), element("dd", where)]));
  const all = snippets(told, id);
  byId("connect-none").hidden = all.length > 0;
  byId("connect-snippets").replaceChildren(...all.map(([title, words]) => {
    const item = element("li"), head = element("p", title), block = element("pre", words, { tabIndex: 0 });
    const copy = element("button", "Copy", { type: "button" });
    block.setAttribute("aria-label", title);
    copy.setAttribute("aria-label", `Copy: ${title}`);
    copy.addEventListener("click", async () => {
      copy.textContent = (await copied(block)) ? "Copied" : "Press Ctrl+C";
      setTimeout(() => { copy.textContent = "Copy"; }, LEAVES_MS);
    });
    head.append(copy);
    item.append(head, block);
    return item;
  }));
}

/** Into the clipboard, where the browser lets a page of this address; else it is selected, to be copied by hand. */
async function copied(block) {
  getSelection().selectAllChildren(block);
  try {
    await navigator.clipboard.writeText(block.textContent);
    return true;
  } catch {
    return false;
  }
}
