"""The files that the parts of a fleet can be started from are what their engines take."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml
from support.command import plotfeed_here
from support.scene_files import radar, scene_file, scene_text

from plotfeed.feeds.cli.main import cli

FOLDER = Path(__file__).parents[3] / "examples" / "fleet"
START = "2026-01-01T12:00:00Z"


def takes(words: Sequence[str]) -> dict[str, Any]:
    """What `plotfeed run` makes of its words; raises what it would."""
    assert words[0] == "run"
    return cli.commands["run"].make_context("run", list(words[1:])).params


def test_the_services_of_compose_are_all_parts_of_one_scene() -> None:
    services = yaml.safe_load((FOLDER / "compose.yaml").read_text())["services"]
    mounted = services["broker"]["volumes"][0].partition(":")[0]
    assert (FOLDER / mounted).is_file()
    for service in services.values():
        assert service["read_only"]
        assert service["cap_drop"] == ["ALL"]
        assert service["security_opt"] == ["no-new-privileges:true"]
    parts = {name: takes(each["command"]) for name, each in services.items() if name != "broker"}
    assert {asked["part"] for asked in parts.values()} == {"1/3", "2/3", "3/3"}
    assert len({str(asked | {"part": ""}) for asked in parts.values()}) == 1
    assert all(asked["wait"] for asked in parts.values())
    assert all(services[name]["restart"] == "on-failure" for name in parts)


def test_the_service_of_systemd_starts_a_part() -> None:
    text = (FOLDER / "plotfeed-part@.service").read_text()
    (line,) = re.findall(r"^ExecStart=\S+/plotfeed (.*)$", text, re.MULTILINE)
    asked = takes(line.replace("%i", "1").replace("${PARTS}", "3").split())
    assert asked["part"] == "1/3"
    assert asked["start"] == "${START}"
    assert asked["wait"]


@pytest.mark.parametrize("spares", [0, 1])
def test_kubernetes_is_told_to_run_each_part_and_those_that_stand_by(
    tmp_path: Path, spares: int
) -> None:
    scene = scene_file(tmp_path, scene_text(sensors=radar("a") + radar("b")))
    words = ["fleet", scene, "--workers", "2", "--spares", str(spares), "--kubernetes"]
    words += ["--broker", "mqtt://broker.example:1883", "--start", START, "--duration", "60"]
    done = plotfeed_here(*words)
    assert done.returncode == 0, done.stderr
    policy, *every = yaml.safe_load_all(done.stdout)
    labels = policy["spec"]["podSelector"]["matchLabels"]
    assert policy["spec"]["policyTypes"] == ["Ingress", "Egress"]
    assert "ingress" not in policy["spec"]  # nobody may reach a part
    assert policy["spec"]["egress"][0] == {"ports": [{"protocol": "TCP", "port": 1883}]}
    assert [each["kind"] for each in every] == ["StatefulSet"] * (1 + spares)
    assert len({each["metadata"]["name"] for each in every}) == len(every)
    for each in every:
        spec, template = each["spec"], each["spec"]["template"]
        assert spec["replicas"] == 2
        assert spec["ordinals"] == {"start": 1}
        assert spec["selector"]["matchLabels"].items() <= template["metadata"]["labels"].items()
        volumes = {volume["name"] for volume in template["spec"]["volumes"]}
        assert labels.items() <= template["metadata"]["labels"].items()
        assert template["spec"]["securityContext"]["runAsNonRoot"]
        (container,) = template["spec"]["containers"]
        assert container["securityContext"] == {
            "allowPrivilegeEscalation": False,
            "readOnlyRootFilesystem": True,
            "capabilities": {"drop": ["ALL"]},
        }
        assert {mount["name"] for mount in container["volumeMounts"]} == volumes
        (source,) = (env["valueFrom"] for env in container["env"] if env["name"] == "PART")
        assert source["fieldRef"]["fieldPath"] == "metadata.labels['apps.kubernetes.io/pod-index']"
        asked = takes(container["args"])
        assert (asked["part"], asked["start"], asked["duration"]) == ("$(PART)/2", START, 60.0)
        assert (asked["broker"], asked["wait"]) == ("mqtt://broker.example:1883", True)
