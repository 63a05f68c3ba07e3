"""The files that a fleet can be started from are what their engines take, as far as can be seen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from plotfeed.feeds.cli.fleet import fleet

FOLDER = Path(__file__).parents[3] / "examples" / "fleet"


def takes(words: list[str]) -> dict[str, Any]:
    """What the command makes of its words; raises what it would."""
    assert words[0] == "fleet"
    return fleet.make_context("fleet", list(words[1:])).params


def test_the_services_of_compose_begin_a_fleet() -> None:
    services = yaml.safe_load((FOLDER / "compose.yaml").read_text())["services"]
    asked = takes(services["coordinator"]["command"])
    assert asked["ray_address"] == "head:6379"
    assert asked["broker"] == "mqtt://broker:1883"
    assert {each for service in services.values() for each in service.get("depends_on", ())} <= (
        services.keys()
    )
    mounted = services["broker"]["volumes"][0].partition(":")[0]
    assert (FOLDER / mounted).is_file()
    for name in ("head", "places"):
        assert services[name]["entrypoint"][:2] == ["ray", "start"]
        assert "--block" in services[name]["entrypoint"]


def test_the_deployments_of_kubernetes_begin_a_fleet() -> None:
    every = list(yaml.safe_load_all((FOLDER / "kubernetes.yaml").read_text()))
    assert {each["kind"] for each in every} == {"Service", "Deployment"}
    pods = {each["metadata"]["name"]: each["spec"] for each in every if each["kind"] != "Service"}
    for spec in pods.values():
        template = spec["template"]
        assert spec["selector"]["matchLabels"] == template["metadata"]["labels"]
        volumes = {volume["name"] for volume in template["spec"]["volumes"]}
        (container,) = template["spec"]["containers"]
        assert {mount["name"] for mount in container["volumeMounts"]} == volumes
    (service,) = (each for each in every if each["kind"] == "Service")
    labels = pods["plotfeed-head"]["template"]["metadata"]["labels"]
    assert service["spec"]["selector"] == labels
    (coordinator,) = pods["plotfeed-coordinator"]["template"]["spec"]["containers"]
    asked = takes(coordinator["args"])
    assert asked["ray_address"] == f"{service['metadata']['name']}:6379"
    assert pods["plotfeed-coordinator"]["replicas"] == 1


def test_the_image_has_what_ray_is_installed_from() -> None:
    copied = [
        line.split()[1]
        for line in (FOLDER / "Dockerfile").read_text().splitlines()
        if line.startswith("COPY requirements")
    ]
    assert copied
    assert all((FOLDER.parents[1] / name).is_file() for name in copied)
