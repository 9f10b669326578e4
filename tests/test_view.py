"""``opposable view``: things are recognised by content, shown by a local server, or refused."""

from __future__ import annotations

import json
import shutil
import threading
import urllib.request
from collections.abc import Iterator, Mapping
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from conftest import PlanOf
from serving import serving, small_dataset
from typer.testing import CliRunner

from planner.errors import FileFormatError, NotFoundError, ObjectError, TaskError
from planner.files import write_plan
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.motion.gait import plan_gait
from planner.objects import GraspObject, parse_object
from planner.pages.hand_page import comments_of, described_lines, named_joints
from planner.pages.mesh_page import mesh_page, zero_level_set
from planner.pages.motion_page import object_motion
from planner.pages.page import Page, has_browser, read_page_data, write_page
from planner.plan import GraspPlan
from planner.shapes import Mesh
from planner.system.package import models_dir
from planner.task import GraspTask
from sim.cli import app
from sim.report_file import write_report
from sim.scene.carrier import Timeline
from sim.show.browser import Answer, LocalServer, Opening, show, warnings_of
from sim.show.dataset import DatasetSite, DatasetTables
from sim.show.targets import Kind, Target, ViewOptions, recognise, register_kind
from sim.trial import simulate

RUN = CliRunner()


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("pyarrow")
    return small_dataset(tmp_path_factory.mktemp("data") / "grasps")


@pytest.fixture(scope="module")
def dataset_site(dataset: Path) -> Iterator[LocalServer]:
    with serving(DatasetSite(DatasetTables(dataset))) as server:
        yield server


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "box")


@pytest.fixture
def plan_file(plan: GraspPlan, tmp_path: Path) -> Path:
    write_plan(plan, tmp_path / "anything.txt")
    return tmp_path / "anything.txt"


def kind_of(target: str | Path) -> str:
    return recognise(Target(str(target))).name


def viewed(target: str | Path, options: ViewOptions | None = None) -> Page:
    found = Target(str(target))
    page = recognise(found).shown(found, options or ViewOptions())
    assert isinstance(page, Page)
    return page


# ---- what it is


def test_hands_are_recognised_by_name_folder_description_and_model(tmp_path: Path) -> None:
    folder = models_dir() / "hands" / "allegro_hand"
    renamed = tmp_path / "a.description"
    shutil.copy(folder / "hand.toml", renamed)
    for target in (
        "allegro_hand",
        folder,
        folder / "hand.toml",
        folder / "allegro_hand.xml",
        renamed,
    ):
        assert kind_of(target).startswith("a hand"), target


def test_a_plan_is_recognised_by_its_format_and_not_by_its_name(plan_file: Path) -> None:
    assert kind_of(plan_file) == "a grasp plan"


def _numbers(data: Any) -> list[float]:
    """All numbers of plain data, in order."""
    if isinstance(data, dict):
        return [n for value in data.values() for n in _numbers(value)]
    if isinstance(data, list):
        return [n for value in data for n in _numbers(value)]
    return [float(data)] if isinstance(data, int | float) else []


def test_the_page_of_a_plan_can_be_viewed_again(plan_file: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    write_page(viewed(plan_file), page)
    again, before = viewed(page).data, read_page_data(page)[1]
    assert again is not None
    # poses are read as rotations and written as quaternions: the last digit may differ
    np.testing.assert_allclose(_numbers(again["grasp"]), _numbers(before["grasp"]), atol=1e-12)
    np.testing.assert_allclose(_numbers(again["task"]), _numbers(before["task"]), atol=1e-12)
    assert json.dumps(again["task"]["hand"]) == json.dumps(before["task"]["hand"])


@pytest.mark.parametrize("suffix", [".ply", ".stl", ".obj", ".glb"])
def test_meshes_are_recognised_by_their_content(suffix: str, tmp_path: Path) -> None:
    file = tmp_path / f"part{suffix}"
    trimesh.creation.box((0.05, 0.04, 0.03)).export(file)
    assert kind_of(file).startswith("an object or mesh")
    assert kind_of(f"{file}*0.5").startswith("an object or mesh")
    other = file.rename(tmp_path / "part.dat")
    assert kind_of(other).startswith("an object or mesh")
    with pytest.raises(ObjectError, match=f"rename it to end in {suffix}"):
        viewed(other)


def test_objects_by_name_and_bodies_of_models_are_objects(tmp_path: Path) -> None:
    scene = tmp_path / "scene.xml"
    scene.write_text(
        '<mujoco><worldbody><body name="block"><freejoint/><geom type="box" size="0.02 0.03 0.04"/>'
        "</body></worldbody></mujoco>"
    )
    for target in ("mug", "box:0.05x0.05x0.08", f"{scene}#block"):
        assert kind_of(target).startswith("an object or mesh"), target


def test_a_page_of_another_kind_is_shown_as_it_is(tmp_path: Path) -> None:
    first, second = tmp_path / "box.html", tmp_path / "again.html"
    write_page(viewed("box"), first)
    done = RUN.invoke(app, ["view", str(first), "--out", str(second)])
    assert done.exit_code == 0, done.output
    assert second.read_bytes() == first.read_bytes()


def test_another_kind_is_one_registration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sim.show.targets._REGISTERED", [])
    kind = Kind(
        name="a note",
        recognises=lambda target: target.is_file and target.head.startswith(b"NOTE"),
        shown=lambda target, options: Page(title=target.content[5:]),
    )
    register_kind(kind)
    (tmp_path / "x").write_text("NOTE hello")
    assert viewed(tmp_path / "x").title == "hello"
    with pytest.raises(FileFormatError, match="a note"):
        kind_of(tmp_path)


# ---- what cannot be viewed: one clear line each


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"hello, world\n", "it is of another kind; what can be: a hand"),
        (b"", "it is of another kind"),
        (b"\x00\xff" * 50, "it is of another kind"),
        (b'{"format": "opposable-plan", "version": 1,', "is damaged or not JSON"),
        (b'{"format": "opposable-report", "version": 7}', "version 7"),
        (b'{"format": "other-thing"}', "its format is 'other-thing'"),
        (b"<!DOCTYPE html><html><body>news</body></html>", "not a page with numbers in it"),
        (b"a = 1\nb = 'two'\n", "it is of another kind"),
    ],
)
def test_a_foreign_or_damaged_file_is_refused(content: bytes, message: str, tmp_path: Path) -> None:
    file = tmp_path / "thing.bin"
    file.write_bytes(content)
    with pytest.raises(FileFormatError, match=message) as refusal:
        viewed(file)
    assert "\n" not in str(refusal.value)


def test_a_foreign_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="cannot be viewed"):
        kind_of(tmp_path)


def test_a_name_of_nothing_says_what_there_is() -> None:
    with pytest.raises(NotFoundError, match="Did you mean 'allegro_hand'"):
        kind_of("alegro_hand")
    with pytest.raises(NotFoundError, match=r"^runs/report\.json does not exist; give a file"):
        kind_of("runs/report.json")


def test_options_that_mean_nothing_are_refused() -> None:
    done = RUN.invoke(app, ["view", "mug", "--alternatives", "2"])
    assert done.exit_code == 3
    assert "--alternatives means nothing for an object" in done.output


@pytest.mark.slow
def test_a_mesh_of_many_triangles_is_decimated_and_says_so() -> None:
    fine = trimesh.creation.icosphere(subdivisions=6, radius=0.04)
    shape = Mesh.from_triangles(np.array(fine.vertices), np.array(fine.faces))
    page = mesh_page(GraspObject(name="ball", shape=shape))
    assert page.scene is not None
    drawn = sum(len(p.triangles) for p in page.scene.models["object"].parts if p.layer == "object")
    assert drawn < 81_920 / 2
    told = [b.text for b in page.summary if hasattr(b, "text")]
    assert any("of the object's 81920" in text for text in told)


# ---- where it is shown


class Echo:
    """A site that answers with the address it is asked for."""

    def answer(self, path: str, query: Mapping[str, str]) -> Answer | None:
        if path == "/fault":
            raise FileFormatError("this cannot be shown; try another")
        return None if path.startswith("/none") else Answer(body=path.encode())


@pytest.fixture
def server() -> Iterator[LocalServer]:
    with serving(Echo()) as made:
        yield made


def asked(server: LocalServer, path: str, host: str | None = None) -> tuple[int, bytes]:
    connection = HTTPConnection("127.0.0.1", server.port, timeout=10)
    connection.request("GET", path, headers={"Host": host} if host else {})
    answer = connection.getresponse()
    found = answer.status, answer.read()
    connection.close()
    return found


def test_the_server_answers_faults_in_one_line(server: LocalServer) -> None:
    assert asked(server, "/") == (200, b"/")
    assert asked(server, "/none")[0] == 404
    status, text = asked(server, "/fault")
    assert (status, text) == (422, b"this cannot be shown; try another")


def test_the_server_answers_to_no_other_name(server: LocalServer) -> None:
    assert asked(server, "/", "localhost:9")[0] == 200  # as ssh forwards it
    assert asked(server, "/", "evil.example")[0] == 403
    assert asked(server, "/", "127.0.0.1.evil.example")[0] == 403


def test_the_server_listens_to_this_machine_alone(server: LocalServer) -> None:
    assert server._server.socket.getsockname() == ("127.0.0.1", server.port)
    assert server.address == f"http://127.0.0.1:{server.port}/"


def test_no_address_reaches_the_disk(dataset_site: LocalServer) -> None:
    for path in (
        "/../../../../etc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/manifest.json",
        "/grasp/../manifest.json",
        "/details/-1",
        "/grasp/0x1",
        "//etc/passwd",
    ):
        status, body = asked(dataset_site, path)
        assert status == 404, path
        assert b"root:" not in body
        assert b"opposable-grasps" not in body


def test_a_port_in_use_is_said(server: LocalServer) -> None:
    with pytest.raises(TaskError, match=f"port {server.port}.*give another --port"):
        LocalServer(Echo(), server.port)


def test_without_a_display_there_is_no_browser(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert not has_browser()


def test_without_a_browser_it_serves_and_says_where(
    monkeypatch: pytest.MonkeyPatch, plan_file: Path
) -> None:
    monkeypatch.setattr("sim.show.browser.has_browser", lambda: False)
    said: list[str] = []
    pages: list[bytes] = []

    def interrupted(self: LocalServer) -> None:
        thread = threading.Thread(target=self._server.serve_forever)
        thread.start()
        pages.append(urllib.request.urlopen(self.address).read())
        self.stop()
        thread.join()
        raise KeyboardInterrupt

    monkeypatch.setattr(LocalServer, "run", interrupted)
    show(viewed(plan_file), Opening(port=0), said.append)
    assert said[0].startswith("open http://127.0.0.1:")
    assert "ssh -N -L" in said[1]
    assert said[-1] == "stopped"
    assert pages[0].startswith(b"<!DOCTYPE html>")


def test_with_a_browser_a_file_is_opened(monkeypatch: pytest.MonkeyPatch, plan_file: Path) -> None:
    opened: list[str] = []
    monkeypatch.setattr("sim.show.browser.has_browser", lambda: True)
    monkeypatch.setattr("webbrowser.open", opened.append)
    show(viewed(plan_file), Opening(), lambda _: None)
    (address,) = opened
    assert address.startswith("file://")
    assert read_page_data(Path(address.removeprefix("file://")))[0] == "plan"


def test_a_page_is_written_where_it_is_asked_for(plan_file: Path, tmp_path: Path) -> None:
    done = RUN.invoke(app, ["view", str(plan_file), "--out", str(tmp_path / "p.html")])
    assert done.exit_code == 0, done.output
    assert read_page_data(tmp_path / "p.html")[0] == "plan"
    done = RUN.invoke(app, ["view", str(plan_file), "--out", str(tmp_path / "no" / "p.html")])
    assert done.exit_code == 3
    assert "there is no folder" in done.output


def test_a_dataset_is_not_written_into_a_file(dataset: Path, tmp_path: Path) -> None:
    done = RUN.invoke(app, ["view", str(dataset), "--out", str(tmp_path / "p.html")])
    assert done.exit_code == 3
    assert "leave --out away" in done.output


# ---- what is shown


def test_alternatives_stand_beside_the_plan(plan_file: Path) -> None:
    page = viewed(plan_file, ViewOptions(alternatives=2))
    assert page.scene is not None
    ghosts = [a for a in page.scene.actors if a.layer == "alternatives"]
    assert [a.name for a in ghosts] == ["seed 1", "seed 2"]
    assert "alternatives" not in page.scene.off
    assert not np.allclose(ghosts[0].pose, ghosts[1].pose)


def test_lines_of_a_description_have_their_comments_and_joints(allegro: Hand) -> None:
    assert allegro.path is not None
    lines = {line.key: line for line in described_lines(allegro, comments_of(allegro.path))}
    assert "the tip spheres" in lines["fingers.thumb.name"].why
    assert lines["fingers.index.joints"].joints == tuple(allegro.fingers["index"].q_index)
    assert lines["fingers.index.pad"].pads
    assert lines["postures.pinch"].posture == "pinch"
    assert named_joints(allegro, "index_2 overlaps with palm") == (
        -1,
        allegro.joint_index("index_2"),
    )


def test_the_zero_level_is_closed_and_on_the_field() -> None:
    shape = parse_object("torus").shape
    assert isinstance(shape, Mesh)
    vertices, triangles = zero_level_set(shape.field(), *shape.bounds)
    solid = trimesh.Trimesh(vertices, triangles, process=False)
    assert solid.is_watertight
    assert solid.euler_number == 0  # it has a hole, as a torus does
    assert np.abs(shape.field().value(vertices)).max() < 1e-6
    assert solid.volume == pytest.approx(shape.volume, rel=0.05)  # positive: faces look outwards


def test_regions_cover_the_surface(tmp_path: Path) -> None:
    page = viewed("box:0.04x0.04x0.08", ViewOptions(touch=("z>0",), avoid=("x>0.019",)))
    assert page.scene is not None
    parts = {p.name: p for p in page.scene.models["object"].parts if p.layer == "regions"}
    allowed, forbidden = parts["fingers may touch here"], parts["fingers must not touch here"]
    middle = allowed.vertices[allowed.triangles].mean(axis=1)
    assert (middle[:, 2] > -1e-4).all()
    assert (middle[:, 0] < 0.0192).all()
    areas = [
        trimesh.Trimesh(p.vertices, p.triangles, process=False).area for p in (allowed, forbidden)
    ]
    whole = 2 * 0.04 * 0.04 + 4 * 0.04 * 0.08
    assert sum(areas) == pytest.approx(whole, rel=0.02)


def test_a_dataset_has_its_columns_poses_and_attempts(dataset_site: LocalServer) -> None:
    def got(path: str) -> dict:  # type: ignore[type-arg]
        status, body = asked(dataset_site, path)
        assert status == 200
        return json.loads(body)  # type: ignore[no-any-return]

    rows = got("/rows")
    assert rows["count"] == 6
    assert rows["columns"]["object"] == ["sphere:0.035"] * 3 + ["box:0.05x0.05x0.08"] * 3
    found = [i for i, ok in enumerate(rows["columns"]["found"]) if ok]
    poses = got(f"/poses?rows={','.join(map(str, range(9)))}")
    assert sorted(map(int, poses)) == found
    assert len(poses[str(found[0])]["base"]) == 7
    details = got(f"/details/{found[0]}")
    assert len(details["attempts"]) == rows["columns"]["attempts"][found[0]]
    assert details["attempts"][-1]["reason"] == ""
    status, body = asked(dataset_site, "/grasp/77")
    assert status == 422
    assert b"0 to 5" in body


# ---- reports


@pytest.fixture(scope="module")
def run_folder(plan: GraspPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run, with its report as JSON."""
    folder = tmp_path_factory.mktemp("run")
    timeline = Timeline(approach=0.3, close=0.3, squeeze=0.3, settle=0.2, lift=0.4, hold=0.3)
    write_report(simulate(plan, timeline=timeline).to_dict(), folder / "report.json")
    return folder


@pytest.mark.slow
def test_a_report_is_shown_as_file_page_or_folder(run_folder: Path, tmp_path: Path) -> None:
    page = viewed(run_folder / "report.json")
    write_page(page, tmp_path / "report.html")
    for target in (run_folder, tmp_path / "report.html"):
        assert kind_of(target).startswith("a report"), target
        shown = viewed(target)
        assert shown.data == page.data
        assert shown.scene is not None
        assert {"hand", "object"} <= {a.name for a in shown.scene.actors}
        assert warnings_of(shown) == ()


def test_a_report_without_states_says_so_in_one_line(run_folder: Path, tmp_path: Path) -> None:
    old = json.loads((run_folder / "report.json").read_text()) | {"version": 1}
    del old["plan"], old["recording"]
    file = tmp_path / "old.json"
    file.write_text(json.dumps(old))
    done = RUN.invoke(app, ["view", str(file), "--out", str(tmp_path / "old.html")])
    assert done.exit_code == 0
    (line,) = [x for x in done.output.splitlines() if "no recorded states" in x]
    assert "run it again" in line
    assert read_page_data(tmp_path / "old.html")[0] == "report"


# ---- motions


@pytest.mark.slow
def test_pads_stay_on_their_contacts_along_a_gait(shadow: Hand) -> None:
    gait = plan_gait(GraspTask.create(shadow, "cylinder:0.03x0.10"), angle=np.deg2rad(90), seed=0)
    trajectory = gait.joint_trajectory(rate_hz=30.0)
    found = object_motion(gait, trajectory)
    assert {"stroke 2", "regrasp thumb"} <= set(trajectory.phases)
    places = np.array([pose.translation for pose in found.poses])
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() < 1e-3  # m between samples
    turned = found.poses[0].rotation.T @ found.poses[-1].rotation
    assert np.arctan2(turned[1, 0], turned[0, 0]) == pytest.approx(gait.angle, abs=1e-6)
    off = []
    for q, base, pose, contacts in zip(
        trajectory.positions, trajectory.T_world_base, found.poses, found.contacts, strict=True
    ):
        if contacts is None:
            continue
        state = HandState(shadow, q)
        for name, point in zip(contacts.fingers, contacts.positions, strict=True):
            pad = shadow.fingers[name].pad
            centre = (base * state.joint_pose(pad.joint_id)).act(pad.center)
            off.append(abs(float(np.linalg.norm(centre - pose.act(point))) - pad.radius))
    assert max(off) < 5e-4  # the tolerance of touch
    assert len(off) > 500
