"""`vibrissa simulate-sensor`: a simulated sensor on the loopback address that plays a scan."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import vibrissa as vb
from vibrissa.cli import common
from vibrissa.cli.live_parts import rdt_of, say, working
from vibrissa.cli.progress import reporting


def simulate_sensor(
    case: common.CaseFile,
    setup: Annotated[Path, typer.Option(help="TOML file with [rod], [sensor] and [rdt].")],
    rate: Annotated[
        float | None,
        typer.Option(help="Records per second; default is the setup's.", callback=common.positive),
    ] = None,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port to listen on.")] = 49152,
    duration: Annotated[
        float | None,
        typer.Option(help="Seconds to run after the first request.", callback=common.positive),
    ] = None,
    rest: Annotated[
        float | None,
        typer.Option(
            help="Seconds at rest before the first trail; default is the tare's plus 0.1 s.",
        ),
    ] = None,
    sweep: Annotated[float, typer.Option(help="Seconds for each trail.")] = 10.0,
    pause: Annotated[float, typer.Option(help="Seconds between trails.")] = 0.5,
    repeat: Annotated[
        bool, typer.Option("--repeat", help="Play the case again and again.")
    ] = False,
    tare: Annotated[
        str, typer.Option(help="Offsets of the sensor: fx,fy,fz,tx,ty,tz [N], [N m].")
    ] = "0,0,0,0,0,0",
    pose: Annotated[
        str | None, typer.Option(help="udp://HOST:PORT to which poses are sent as JSON.")
    ] = None,
    pose_rate: Annotated[
        float, typer.Option(help="Poses per second.", callback=common.positive)
    ] = 250.0,
    buffer: Annotated[int, typer.Option(help="Records per datagram in buffered mode.")] = 20,
    drop: Annotated[float, typer.Option(help="Share of datagrams that are lost.")] = 0.0,
    duplicate: Annotated[float, typer.Option(help="Share of datagrams that come twice.")] = 0.0,
    reorder: Annotated[
        float, typer.Option(help="Share of datagrams that come after the next one.")
    ] = 0.0,
    malformed: Annotated[
        float,
        typer.Option(help="Share of datagrams that are followed by a broken one."),
    ] = 0.0,
    error: Annotated[float, typer.Option(help="Share of datagrams whose status says error.")] = 0.0,
    seed: Annotated[int, typer.Option(help="Seed of noise and flaws.")] = 0,
    as_json: common.AsJson = False,
) -> None:
    """Play a scan as an Ethernet force/torque sensor: RDT over UDP, with the noise and counts
    of the setup.
    """
    import numpy as np  # noqa: PLC0415

    from vibrissa.geometry.checks import finite_array  # noqa: PLC0415
    from vibrissa.live.address import host_and_port, listening  # noqa: PLC0415
    from vibrissa.live.process import TARE_SECONDS  # noqa: PLC0415
    from vibrissa.live.scene import measured, swept  # noqa: PLC0415

    with reporting() as report:
        report("loading")
        loaded, setting = vb.load_case(case, progress=report.count), vb.load_setup(setup)
    table, tared = rdt_of(setting), setting.sensor.tare_seconds
    every = rate or table.rate
    resting = (TARE_SECONDS if tared is None else tared) + 0.1
    try:
        if not 0 <= port <= 65535:
            raise ValueError(f"port = {port}; allowed is a port from 1 to 65535, or 0 for any")
        try:
            offsets = finite_array(tare.split(","), "tare", last=6)
        except ValueError as failure:
            text = f"tare = {tare!r}; allowed are six finite numbers fx,fy,fz,tx,ty,tz"
            raise ValueError(text) from failure
        flaws = vb.live.Flaws(drop, duplicate, reorder, malformed, error)
        listener = None if pose is None else host_and_port(pose)
        with working():
            listening(host, port).close()
        say("scanning")
        scene = swept(
            loaded.rod,
            loaded.surface,
            loaded.trail,
            rest=resting if rest is None else rest,
            sweep=sweep,
            pause=pause,
            friction=loaded.friction,
            finite_radius=loaded.finite_radius,
        )
        if not np.any(scene.force):
            common.warn("the rod never touches the object: only noise is sent")
        rng = np.random.default_rng(seed)
        simulator = vb.live.SensorSimulator(
            measured(scene, setting.sensor, every, rng, tare=offsets, repeat=repeat),
            counts_per_force=table.counts_per_force,
            counts_per_torque=table.counts_per_torque,
            rate=every,
            host=host,
            port=port,
            buffer=buffer,
            flaws=flaws,
            seed=seed,
            poses=listener,
            pose_rate=pose_rate,
            notice=say,
        )
    except ValueError as failure:
        raise vb.io.InputError(str(failure)) from failure
    assert scene.time is not None
    with working() as stop:
        simulator.open()
        say(
            f"listening at {host}:{simulator.port}, {every:g} records a second, one scan lasts "
            f"{scene.time[-1]:g} s"
        )
        try:
            sent = simulator.run(duration=duration, stop=stop)
        finally:
            simulator.close()
    if as_json:
        common.show(vars(sent), str, as_json=True)
        return
    text = (
        f"{sent.records} records, {sent.sent} of them sent, {sent.dropped} dropped; {sent.poses} "
        f"poses; {sent.malformed_requests} requests malformed; largest delay "
        f"{sent.latest * 1e3:.2f} ms"
    )
    if sent.takeovers:
        text += f"; the stream was taken by another client {sent.takeovers} times"
    say(text)
