"""Manifests with which Kubernetes runs the parts of a fleet."""

from __future__ import annotations

import json
from pathlib import Path

HEAD = """\
# {parts} parts of a scene, each a pod that Kubernetes starts again. First:
#
#   kubectl create configmap plotfeed-scene --from-file=scene.toml={scene}
#
# and with it the scene's other files, as --from-file=FILE each; then kubectl apply --filename this
# file. Pods connect to {broker} and listen on no port.
"""
STATEFUL_SET = """\
---
apiVersion: apps/v1
kind: StatefulSet
metadata:
  name: {name}
spec:
  replicas: {parts}
  ordinals: {{start: 1}}  # the pod {name}-K runs part K; from Kubernetes 1.27 on
  podManagementPolicy: Parallel
  selector:
    matchLabels: {{app: {name}}}
  template:
    metadata:
      labels: {{app: {name}, fleet: plotfeed}}
    spec:
      terminationGracePeriodSeconds: 15
      topologySpreadConstraints:  # over the nodes, also those of a part that stand by
        - maxSkew: 1
          topologyKey: kubernetes.io/hostname
          whenUnsatisfiable: ScheduleAnyway
          labelSelector:
            matchLabels: {{fleet: plotfeed}}
      containers:
        - name: plotfeed
          image: plotfeed
          imagePullPolicy: IfNotPresent
          args: {arguments}
          env:
            - name: PART
              valueFrom:
                fieldRef: {{fieldPath: "metadata.labels['apps.kubernetes.io/pod-index']"}}
            - name: PLOTFEED_MQTT_USERNAME
              valueFrom: {{secretKeyRef: {{name: plotfeed-mqtt, key: username, optional: true}}}}
            - name: PLOTFEED_MQTT_PASSWORD
              valueFrom: {{secretKeyRef: {{name: plotfeed-mqtt, key: password, optional: true}}}}
          resources:
            requests: {{cpu: "1", memory: 512Mi}}
            limits: {{memory: 2Gi}}
          volumeMounts:
            - {{name: scene, mountPath: /scene, readOnly: true}}
      volumes:
        - name: scene
          configMap: {{name: plotfeed-scene}}
"""


def manifests(
    scene: Path, *, parts: int, spares: int, start: str, broker: str, duration_s: float | None
) -> str:
    """YAML: a StatefulSet of a pod a part, and one more of pods that stand by for each spare."""
    words = ["run", "/scene/scene.toml", "--part", f"$(PART)/{parts}", "--start", start]
    words += ["--broker", broker, "--wait"]
    words += [] if duration_s is None else ["--duration", f"{duration_s:g}"]
    names = ["plotfeed-part", *(f"plotfeed-spare-{n}" for n in range(1, spares + 1))]
    return HEAD.format(parts=parts, scene=scene, broker=broker) + "".join(
        STATEFUL_SET.format(name=name, parts=parts, arguments=json.dumps(words)) for name in names
    )
