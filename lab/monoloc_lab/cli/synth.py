"""``monoloc synth``: rendered rooms and flights through them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import typer

from monoloc.camera import Camera
from monoloc.cli.common import (
    JsonOption,
    SeedOption,
    print_json,
    stderr,
)
from monoloc.cli.output_checks import check_folder
from monoloc.errors import SettingError
from monoloc.geometry import FloatArray
from monoloc.io.pose_files import read_tum
from monoloc.io.tum_trajectory import write_tum
from monoloc.progress import ConsoleProgress
from monoloc_lab.synth.blur import velocities
from monoloc_lab.synth.corridor import corridor as make_corridor
from monoloc_lab.synth.corridor import door_walk, mapping_walk
from monoloc_lab.synth.flights import FlightConfig, plan_flight
from monoloc_lab.synth.inertial import ImuModel, OdometryModel, simulate_imu, simulate_odometry, write_imu
from monoloc_lab.synth.layout import generate_room, imported_room
from monoloc_lab.synth.light import LIGHTS, Light
from monoloc_lab.synth.random_views import render_views
from monoloc_lab.synth.render import require_mitsuba
from monoloc_lab.synth.rooms import Room, read_room, write_room
from monoloc_lab.synth.sequence import ROOM, RenderConfig, render_sequence

app = typer.Typer(help="Generate rooms, plan flights, and render them.", no_args_is_help=True, rich_markup_mode=None)

_FOCAL_SHARE = 0.854  # focal length over width: the field of view of NYU, 61 degrees
_FLIGHT, _SECONDS = "flight.txt", 10.0

OutOption = Annotated[Path, typer.Option("--out", "-o", help="Output folder.")]
RoomOption = Annotated[
    Path | None, typer.Option("--room", help="A room.json. [OUT/room.json, or a room from the seed]")
]
SecondsOption = Annotated[
    float | None, typer.Option("--seconds", min=1.0, max=600.0, help="Duration of the flight. [10]")
]
WidthOption = Annotated[
    int, typer.Option("--width", min=32, max=1920, help="Width of the images; the height is 3/4 of it.")
]
SamplesOption = Annotated[int, typer.Option("--samples", min=1, help="Paths per pixel and light group.")]


@app.command()
def room(
    out: OutOption,
    seed: SeedOption = 0,
    mesh: Annotated[
        Path | None, typer.Option("--mesh", help="A ply of triangles (metres, z up) to use as the room.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Generate a furnished room.

    \b
    Examples:
      monoloc synth room --seed 3 --out home
      monoloc synth room --mesh scan.ply --out scanned
    """
    check_folder(out, "--out")
    made = generate_room(seed) if mesh is None else imported_room(mesh)
    _check_same_room(out, made)
    out.mkdir(exist_ok=True)
    write_room(out / ROOM, made)
    if json:
        print_json({"room": str(out / ROOM), "size_m": list(made.size), "objects": made.names})
    else:
        width, depth, height = made.size
        stderr.print(f"{out / ROOM}: {width:.2f} x {depth:.2f} x {height:.2f} m, {len(made.objects)} objects")


@app.command()
def flight(
    out: OutOption,
    seed: SeedOption = 0,
    room: RoomOption = None,
    seconds: SecondsOption = None,
    json: JsonOption = False,
) -> None:
    """Plan the flight of a drone: camera poses at 30 Hz, and simulated IMU and odometer.

    OUT/flight.txt and OUT/odometry.txt are TUM trajectories. OUT/imu.csv has 200 samples per second.

    \b
    Examples:
      monoloc synth flight --seed 3 --out home
      monoloc synth flight --seed 4 --room home/room.json --seconds 30 --out second-flight
    """
    check_folder(out, "--out")
    made = _room(room, out, seed)
    planned = plan_flight(made, FlightConfig(seconds=seconds or _SECONDS), seed)
    rng = np.random.default_rng([seed, 0x1A1])
    poses = planned.camera_poses()
    out.mkdir(exist_ok=True)
    write_room(out / ROOM, made)
    write_tum(out / _FLIGHT, planned.times_s, poses)
    write_tum(out / "odometry.txt", planned.times_s, simulate_odometry(poses, OdometryModel(), rng))
    write_imu(out / "imu.csv", simulate_imu(planned, ImuModel(), rng))
    length = float(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum())
    if json:
        files = {"flight": str(out / _FLIGHT), "odometry": str(out / "odometry.txt"), "imu": str(out / "imu.csv")}
        print_json({**files, "frames": len(poses), "length_m": length})
    else:
        stderr.print(f"{out / _FLIGHT}: {len(poses)} poses, {length:.1f} m")


@app.command()
def render(
    out: OutOption,
    seed: SeedOption = 0,
    room: RoomOption = None,
    poses: Annotated[
        Path | None, typer.Option("--poses", help="A TUM trajectory. [OUT/flight.txt, or a flight from the seed]")
    ] = None,
    seconds: SecondsOption = None,
    every: Annotated[int, typer.Option("--every", min=1, help="Render every N-th pose.")] = 2,
    lights: Annotated[
        list[str] | None, typer.Option("--light", help="L1, L2 or L3; may be repeated. [all three]")
    ] = None,
    width: WidthOption = 320,
    samples: SamplesOption = 64,
    depth: Annotated[
        Literal["exact", "sensor"],
        typer.Option("--depth", help="Exact, or simulated structured-light sensor."),
    ] = "exact",
    json: JsonOption = False,
) -> None:
    """Render a flight through a room in the lights of the paper: recordings OUT/L1, OUT/L2, OUT/L3.

    A stopped rendering continues when called again. Needs the extra "synth"; with LLVM 17 or newer it is several
    times faster.

    \b
    Examples:
      monoloc synth render --seed 3 --out home
      monoloc synth render --room home/room.json --poses my-flight.txt --light L3 --depth sensor --out dark
      monoloc build folder:home/L2 --out home.monoloc
    """
    check_folder(out, "--out")
    chosen = [_light(name) for name in lights or list(LIGHTS)]
    require_mitsuba()
    made = _room(room, out, seed)
    times_s, trajectory = _trajectory(poses, out, made, seconds, seed)
    camera = _camera(width)
    config = RenderConfig(samples=samples, depth=depth)
    progress = ConsoleProgress(stderr)
    rendered = (trajectory[::every], times_s[::every], velocities(trajectory, times_s)[::every])
    recordings = render_sequence(made, *rendered, camera, chosen, config, seed, out, progress)
    if json:
        print_json({"recordings": [str(path) for path in recordings], "frames": len(trajectory[::every])})
    else:
        stderr.print("recordings: " + ", ".join(f"folder:{path}" for path in recordings))


@app.command()
def corridor(
    out: OutOption,
    seed: SeedOption = 0,
    doors: Annotated[int, typer.Option("--doors", min=2, max=20, help="Doors in each side wall.")] = 5,
    width: WidthOption = 320,
    samples: SamplesOption = 8,
    json: JsonOption = False,
) -> None:
    """Render a corridor with equal doors, in which a lost camera must not be found at a wrong one.

    OUT/map is a walk to build from; OUT/door-0, ... are flights that begin at a door and end at the east end.

    \b
    Examples:
      monoloc synth corridor --out corridor
      monoloc build folder:corridor/map/L1 --out corridor.monoloc
      monoloc localize corridor.monoloc folder:corridor/door-1/L1
    """
    check_folder(out, "--out")
    require_mitsuba()
    made, camera = make_corridor(doors), _camera(width)
    out.mkdir(exist_ok=True)
    walks = {"map": mapping_walk(doors), **{f"door-{door}": door_walk(doors, door) for door in range(doors - 1)}}
    recordings = []
    for name, (times_s, poses) in walks.items():
        rendered = (poses, times_s, np.zeros((len(poses), 6)))  # without motion blur: what is alike stays alike
        config, progress = RenderConfig(samples=samples), ConsoleProgress(stderr)
        recordings += render_sequence(made, *rendered, camera, [LIGHTS["L1"]], config, seed, out / name, progress)
    if json:
        print_json({"recordings": [str(path) for path in recordings]})
    else:
        stderr.print("recordings: " + ", ".join(f"folder:{path}" for path in recordings))


@app.command()
def views(
    out: OutOption,
    seed: SeedOption = 0,
    rooms: Annotated[int, typer.Option("--rooms", min=1, help="Number of rooms.")] = 40,
    count: Annotated[int, typer.Option("--views", min=1, help="Views per room.")] = 60,
    samples: SamplesOption = 32,
    json: JsonOption = False,
) -> None:
    """Render a training set for depth networks: random views of many rooms in varied light, as pairs.

    Called again, it continues with the first unfinished room.

    \b
    Examples:
      monoloc synth views --rooms 40 --views 60 --out rooms
      monoloc synth views --seed 1000 --rooms 4 --views 25 --out validation-rooms
    """
    check_folder(out, "--out")
    require_mitsuba()
    render_views(rooms, count, samples, seed, out, ConsoleProgress(stderr))
    if json:
        print_json({"recording": str(out), "pairs": rooms * count})
    else:
        stderr.print(f"folder:{out}: {rooms * count} pairs")


def _room(given: Path | None, out: Path, seed: int) -> Room:
    if given is not None:
        room = read_room(given)
        _check_same_room(out, room)
        return room
    return read_room(out / ROOM) if (out / ROOM).is_file() else generate_room(seed)


def _check_same_room(out: Path, room: Room) -> None:
    """Refuse the folder of another room, to keep rooms and flights apart.

    Raises:
        SettingError: the folder has another room.
    """
    file = out / ROOM
    if file.is_file() and read_room(file) != room:
        raise SettingError("--out", f"{file} is another room", "name another folder, or remove this one")


def _trajectory(
    given: Path | None, out: Path, room: Room, seconds: float | None, seed: int
) -> tuple[FloatArray, FloatArray]:
    file = given or out / _FLIGHT
    if given is not None or file.is_file():
        if seconds is not None:
            raise SettingError("--seconds", f"has no effect: the flight is that of {file}", "leave it out")
        return read_tum(file)
    planned = plan_flight(room, FlightConfig(seconds=seconds or _SECONDS), seed)
    return planned.times_s, planned.camera_poses()


def _camera(width: int) -> Camera:
    height, focal_px = round(0.75 * width), _FOCAL_SHARE * width
    return Camera(width, height, focal_px, focal_px, (width - 1) / 2.0, (height - 1) / 2.0)


def _light(name: str) -> Light:
    if name not in LIGHTS:
        raise SettingError("--light", f"is {name!r}", f"choose one of {', '.join(LIGHTS)}")
    return LIGHTS[name]
