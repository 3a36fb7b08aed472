"""The viewer: echoes to blocks per CPU-second beside reading COPC, blocks from the cache, a lasso, and the page.

.venv/bin/python -m pytest -q -s tests/bench/bench_view.py         # the demo's survey, run here
FWCLASS_VIEWED=RUN .venv/bin/python -m pytest -q -s tests/bench/bench_view.py   # any finished run with tiles
"""

from __future__ import annotations

import base64
import os
import shutil
import subprocess
import tarfile
import threading
import time
from contextlib import suppress
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import laspy
import numpy as np
import pytest
import shapely
from drawn import drawn
from manytiles import many_tiles
from pagedriver import driven
from smallsurvey import small_survey

from fwclass import conf
from fwclass.delivery.opened import open_run
from fwclass.delivery.process import process
from fwclass.delivery.viewed import ViewedRun
from fwclass.delivery.viewing import scenes_of
from fwclass.view.blocks import HEAD
from fwclass.view.scene import ECHOES
from fwclass.view.selection import Selection, in_polygon
from fwclass.view.server import Server

pytestmark = pytest.mark.bench

HEAP = "performance.memory.usedJSHeapSize"

WALK = """(() => { const c = document.getElementById('view'), out = [];
delete fwclass.stats.wave_ms; delete fwclass.stats.why_ms;
for (let k = 0; k < 60; k += 1) {
const x = c.clientWidth * (0.3 + 0.4 * ((k * 7) % 13) / 13), y = c.clientHeight * (0.35 + 0.3 * ((k * 5) % 11) / 11);
if (fwclass.click(x, y)) out.push(fwclass.stats.pick); } return out.sort((a, b) => a - b); })()"""

STRIPS = """(async () => { const c = document.getElementById('view'), out = {};
for (let k = 0; k < 400 && Object.keys(out).length < 8; k += 1) {
const x = c.clientWidth * ((k * 7) % 29 + 0.5) / 29, y = c.clientHeight * (0.1 + 0.8 * ((k * 5) % 23) / 23);
delete fwclass.stats.wave_ms; delete fwclass.stats.why_ms; fwclass.stats.echo = null;
if (!fwclass.click(x, y)) continue;
const end = performance.now() + 20000, wait = async (done) => {
while (!done() && performance.now() < end) await new Promise((go) => setTimeout(go, 2)); return done(); };
if (!await wait(() => fwclass.stats.echo && fwclass.stats.wave_ms && fwclass.stats.why_ms)) return out;
const strip = fwclass.stats.echo.values.strip; out[strip] ??= [];
out[strip].push([fwclass.stats.wave_ms, fwclass.stats.why_ms]); } return out; })()"""

TURN = """(async () => { fwclass.stats.frames.length = 0;
for (let k = 0; k < 40; k += 1) {
fwclass.cam.azimuth += 0.02; fwclass.moved(); await new Promise(requestAnimationFrame); }
const f = [...fwclass.stats.frames].sort((a, b) => a - b); return [f.length, f[f.length >> 1], f.at(-1)]; })()"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    named = os.environ.get("FWCLASS_VIEWED")
    return Path(named) if named else process("demo", tmp_path_factory.mktemp("viewed") / "run").root


def test_echoes_to_blocks(run: Path) -> None:
    params = conf.section("view", ())
    made(ViewedRun(open_run(run), params))  # compiles
    scene = ViewedRun(open_run(run), params)
    seconds, size = made(scene)
    again, _ = made(scene)
    print(
        f"\n{scene.echoes:,} echoes: {scene.echoes / seconds / 1e6:.2f} M a CPU-second to blocks, "
        f"{size / scene.echoes:.2f} bytes an echo; from the cache {scene.echoes / max(again, 1e-3) / 1e6:.0f} M or more"
    )
    began, points = time.process_time(), 0
    for path in sorted((run / "laz" / "tiles").glob("*.laz"))[:20]:
        points += len(laspy.read(path).points)
    if points:
        other = (time.process_time() - began) / points * scene.echoes
        print(f"LASzip of the COPC tiles alone {scene.echoes / other / 1e6:.2f} M: ratio {other / seconds:.1f}")
        assert seconds < other


def made(scene: ViewedRun) -> tuple[float, int]:
    """CPU seconds for every block, and their bytes; every echo is in one."""
    began = time.process_time()
    levels = [scene.level(ECHOES, level) for level in scene.pyramid.levels()]
    seconds = time.process_time() - began
    assert sum(map(echoes_in, levels)) == scene.echoes
    return seconds, sum(map(len, levels))


def echoes_in(level: bytes) -> int:
    """Of all blocks of a level."""
    at = count = 0
    while at < len(level):
        size, _, _, _, n, *_ = HEAD.unpack_from(level, at)
        at, count = at + HEAD.size + size, count + n
    return count


def test_a_lasso(run: Path) -> None:
    """Around the middle of the survey, as large as 10^5 echoes need; nothing is written."""
    scene = ViewedRun(open_run(run), conf.section("view", ()))
    scene.prepare()
    bounds = np.array([t["bounds"] for t in scene.tiles.values()])
    middle, half = (bounds[:, :2].min(axis=0) + bounds[:, 3:5].max(axis=0)) / 2, np.ptp(bounds[:, [0, 1]], axis=0)
    turns = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    for part in (*np.arange(0.02, 1, 0.02), 1.0):
        ring = middle + part * half * np.c_[np.cos(turns), np.sin(turns)]
        selection = Selection.of(drawn(ring))
        began, cpu = time.monotonic(), time.process_time()
        told = scene.relabel.select(selection)
        selected, selecting = time.monotonic() - began, time.process_time() - cpu
        marks = scene.relabel.marks(told["selection"])
        if told["echoes"] >= 100_000:
            break
    print(
        f"\nlasso of 300 corners over {told['echoes']:,} echoes in {told['tiles']} tiles: counted in {selected:.2f} s "
        f"({selecting:.2f} CPU-s), with marks ({len(marks) / 1e6:.1f} MB) {time.monotonic() - began:.2f} s "
        f"({time.process_time() - cpu:.2f} CPU-s)"
    )
    assert time.process_time() - cpu < 0.5  # of a core; the wall's time is that of whatever else runs


def test_a_lasso_beside_another_library() -> None:
    """A million places, 300 corners of a star: our rule, and shapely's prepared polygon."""
    turns, rng = np.linspace(0, 2 * np.pi, 300, endpoint=False), np.random.default_rng(0)
    corners = (1 + 0.3 * np.cos(7 * turns))[:, None] * np.c_[np.cos(turns), np.sin(turns)]
    places = rng.uniform(-1.5, 1.5, (1_000_000, 2))
    polygon = shapely.Polygon(corners)
    shapely.prepare(polygon)
    ours, theirs = [], []
    for _ in range(3):
        began = time.process_time()
        inside = in_polygon(places, corners)
        ours.append(time.process_time() - began)
        began = time.process_time()
        other = shapely.contains_xy(polygon, places[:, 0], places[:, 1])
        theirs.append(time.process_time() - began)
    assert np.array_equal(inside, other)
    print(f"\na million places: {min(ours):.2f} CPU-s, shapely {min(theirs):.2f}, ratio {min(ours) / min(theirs):.2f}")


def page_memory() -> int:
    """Bytes that are the largest page's own of all browsers that run below this process (proportional set size)."""
    below, out = {os.getpid()}, [0]
    for about in sorted(Path("/proc").glob("[0-9]*/stat"), key=lambda p: int(p.parent.name)):
        with suppress(OSError):
            if int(about.read_text().rpartition(")")[2].split()[1]) in below:
                below.add(int(about.parent.name))
                if b"--type=renderer" in (about.parent / "cmdline").read_bytes():
                    rolled = (about.parent / "smaps_rollup").read_text()
                    out.append(1024 * int(rolled.partition("\nPss:")[2].split()[0]))
    return max(out)


def tell_clicks(clicks: dict[str, list[list[float]]]) -> None:
    """Waits for waveform and votes after clicks on each strip [ms]."""
    firsts = [waits[0] for waits in clicks.values()]
    later = sorted(wave for waits in clicks.values() for wave, _ in waits[1:]) or [np.nan]
    votes = [why for waits in clicks.values() for _, why in waits]
    print(
        f"waveform {firsts[0][0]:.0f} ms after the first click, {max(w for w, _ in firsts):.0f} ms at most after that "
        f"of each of {len(firsts)} strips, median of later ones {later[len(later) // 2]:.0f} ms; votes "
        f"{firsts[0][1]:.0f} ms after the first, {max(votes):.0f} ms at most"
    )


def test_the_page(run: Path) -> None:
    params = conf.section("view", ())
    with driven() as page:
        scene = ViewedRun(open_run(run), params)
        with Server([scene], params) as server:
            threading.Thread(target=server.serve_forever, daemon=True).start()
            threading.Thread(target=scene.prepare, daemon=True).start()
            page.open(server.address)
            page.until("window.fwclass.stats.settled", 120)
            stats, traffic = page.run("({...fwclass.stats, frames: 0})"), page.run("fwclass.traffic")
            print(
                f"\nfirst points {stats['first'] / 1e3:.2f} s, whole picture {stats['settled'] / 1e3:.2f} s after the "
                f"script, {stats['drawn']:,} echoes, {traffic['bytes'] / 1e6:.1f} MB in {traffic['requests']} requests "
                f"of data, {len(page.requests)} of all; heap {page.run(HEAP) / 1e6:.0f} MB, the page's process "
                f"{page_memory() / 1e6:.0f} MB; load {os.getloadavg()[0]:.1f}"
            )
            n, middle, most = page.run(TURN)
            print(f"in motion {n} frames, median {middle:.0f} ms, longest {most:.0f} ms")
            if clicks := page.run(STRIPS):
                tell_clicks(clicks)
            else:
                print("this run has no waveforms")
            picks = page.run(WALK)
            assert stats["drawn"] > 0 and picks and (page.faults == [] or not clicks)
            print(f"pick: median {picks[len(picks) // 2]:.0f} ms, longest {picks[-1]:.0f} ms of {len(picks)}")
            if clicks:
                page.until("fwclass.stats.wave_ms && fwclass.stats.why_ms")
                print(f"after the last of them, at once: waveform {page.run('fwclass.stats.wave_ms'):.0f} ms")
            server.shutdown()


OTHER = """<!doctype html><body style="margin:0"><canvas id="c" style="width:100vw;height:100vh;display:block"></canvas>
<script type="module">
import * as THREE from './three.module.js';
const bytes = await (await fetch('echoes.bin')).arrayBuffer();
const n = bytes.byteLength / 15, canvas = document.getElementById('c');
const shape = new THREE.BufferGeometry();
shape.setAttribute('position', new THREE.BufferAttribute(new Float32Array(bytes, 0, 3 * n), 3));
shape.setAttribute('color', new THREE.BufferAttribute(new Uint8Array(bytes, 12 * n, 3 * n), 3, true));
const look = new THREE.PointsMaterial({ vertexColors: true, size: PIXELS, sizeAttenuation: false });
const scene = new THREE.Scene();
scene.background = new THREE.Color(0xeef1f3); scene.add(new THREE.Points(shape, look));
const renderer = new THREE.WebGLRenderer({ canvas, antialias: false });
renderer.setSize(innerWidth, innerHeight, false);
const camera = new THREE.PerspectiveCamera(FIELD, innerWidth / innerHeight, FAR / 100, FAR * 12);
camera.up.set(0, 0, 1);
window.frames_of = async (azimuth) => {
  const out = [], gl = renderer.getContext();
  for (let k = 0; k < 40; k += 1) {
    azimuth += 0.02; const began = performance.now(), s = Math.sin(azimuth), c = Math.cos(azimuth);
    camera.position.set(FAR * s * Math.cos(TILT), -FAR * c * Math.cos(TILT), FAR * Math.sin(TILT));
    camera.lookAt(0, 0, 0);
    renderer.render(scene, camera); gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    out.push(performance.now() - began); await new Promise(requestAnimationFrame);
  }
  return out.sort((a, b) => a - b)[20];
};
window.ready = n;
</script>"""

WHOLE = """(async () => { fwclass.stats.frames.length = 0;
for (let k = 0; k < 40; k += 1) { fwclass.state.motion = 2e6;
fwclass.cam.azimuth += 0.02; fwclass.moved(); await new Promise(requestAnimationFrame); }
const f = [...fwclass.stats.frames].sort((a, b) => a - b); return [f[f.length >> 1], fwclass.stats.drawn]; })()"""

DRAWN = """(() => { const { cam } = fwclass, out = [];
for (const n of fwclass.shown()[0].nodes) { const d = new DataView(n.bytes.buffer, n.bytes.byteOffset);
for (let k = 0; k < n.count; k += 1) out.push(n.low[0] + n.step * d.getUint16(12 * k, true) - cam.target[0],
n.low[1] + n.step * d.getUint16(12 * k + 2, true) - cam.target[1],
n.low[2] + n.rise * d.getUint16(12 * k + 4, true) - cam.target[2]); }
const b = new Uint8Array(new Float32Array(out).buffer); let t = '';
for (let k = 0; k < b.length; k += 0x8000) t += String.fromCharCode(...b.subarray(k, k + 0x8000));
return btoa(t); })()"""


def test_a_frame_beside_three_js(run: Path, tmp_path: Path) -> None:
    """The same echoes, camera, window and size of points, in turns; three.js comes from npm, where that is reached."""
    npm = shutil.which("npm")
    if npm is None or subprocess.run([npm, "pack", "three@0.187"], cwd=tmp_path, capture_output=True).returncode:
        pytest.skip("three.js cannot be had here")
    with tarfile.open(next(tmp_path.glob("three-*.tgz"))) as archive:
        for name in ("three.module.js", "three.core.js"):
            (tmp_path / name).write_bytes(archive.extractfile(f"package/build/{name}").read())  # type: ignore[union-attr]
    params = conf.section("view", ())
    with driven() as page, driven() as other, Server(scenes_of(run, None, params), params) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        page.open(server.address)
        page.until("window.fwclass.stats.settled", 300)
        far, azimuth, tilt, count = page.run(
            "[fwclass.cam.far, fwclass.cam.azimuth, fwclass.cam.tilt, fwclass.stats.drawn]"
        )
        places = base64.b64decode(page.run(DRAWN))
        colours = np.random.default_rng(0).integers(0, 255, len(places) // 4, np.uint8)
        (tmp_path / "echoes.bin").write_bytes(places + colours.tobytes())
        text = (
            OTHER.replace("FAR", repr(far)).replace("TILT", repr(tilt)).replace("FIELD", repr(float(np.degrees(0.8))))
        )
        (tmp_path / "index.html").write_text(text.replace("PIXELS", "1.6"))
        files = ThreadingHTTPServer(("127.0.0.1", 0), partial(SimpleHTTPRequestHandler, directory=str(tmp_path)))
        threading.Thread(target=files.serve_forever, daemon=True).start()
        other.open(f"http://127.0.0.1:{files.server_port}/index.html")
        assert other.until("window.ready", 60) == count
        rounds = []
        for _ in range(3):
            ours, drawn_in_motion = page.run(WHOLE)
            assert drawn_in_motion >= 0.98 * count  # turning, corners of a square survey leave the window
            rounds.append((ours, other.run(f"frames_of({azimuth})")))
        files.shutdown()
        server.shutdown()
    ours, theirs = (sorted(r[k] for r in rounds)[1] for k in (0, 1))
    print(f"\n{count:,} echoes: a frame {ours:.0f} ms, of three.js Points {theirs:.0f} ms, ratio {ours / theirs:.2f}")
    assert ours <= 0.9 * theirs


def test_a_survey_of_many_tiles(tmp_path: Path) -> None:
    """10 000 tiles, or FWCLASS_TILES squared; to make them takes minutes."""
    edge = int(os.environ.get("FWCLASS_TILES", "100"))
    small = process(small_survey(tmp_path, tile=25), tmp_path / "small")
    root = many_tiles(small, tmp_path / "many", edge, 1_000_000)
    began = time.process_time()
    params = conf.section("view", ())
    scenes = scenes_of(root, None, params)
    opened = time.process_time() - began
    with Server(scenes, params) as server, driven() as page:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        page.open(server.address)
        page.until("window.fwclass.stats.settled", 300)
        first, settled, drawn, asked, size = page.run(
            "[fwclass.stats.first, fwclass.stats.settled, fwclass.stats.drawn, fwclass.traffic.requests, "
            "fwclass.traffic.bytes]"
        )
        server.shutdown()
    print(
        f"\n{edge * edge:,} tiles, {scenes[0].echoes:,} echoes: opened in {opened:.1f} CPU-s; "
        f"{type(scenes[0].open).__name__}: first points {first / 1000:.1f} s, {drawn:,} drawn after "
        f"{settled / 1000:.1f} s, {asked} requests, {size / 1e6:.1f} MB; "
        f"{time.process_time() - began:.1f} CPU-s of the server"
    )
    assert asked <= 40 or edge < 100
