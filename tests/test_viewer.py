"""The live viewer: what is played, pushed, shown and chosen, and the page that plays without a server."""

import dataclasses
import shutil
import socket
import time
import urllib.request

import jax
import numpy as np
import pytest

import assistax
from assistax.cli.view import castings, view
from assistax.errors import UsageError
from assistax.evaluation import turns
from assistax.policies import scripted_team
from assistax.viewer import needs
from assistax.viewer.live import Live
from assistax.viewer.panel import Choice
from assistax.viewer.push import STIFFNESS, STRONGEST, Hand, held_by

viser = pytest.importorskip("viser")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture(scope="module")
def live(scratch):
    return Live(scratch, scripted_team("random", scratch), 3)


def test_an_episode_in_pieces_is_the_episode(live, scratch):
    live.begin(3)
    live.advance(7)
    assert live.steps == 7 and not live.over
    live.advance(100)
    assert live.steps == 20 and live.over
    assert live.moment.before == 19
    params, turn = turns.begin(scratch, live.team, jax.random.key(3))
    step = jax.jit(lambda turn, key: turns.advance(scratch, live.team, params, turn, key))
    total = 0.0
    for i in range(20):
        turn, info, _ = step(turn, jax.random.fold_in(jax.random.key(3), i))
        total += sum(map(float, info["reward_terms"].values()))
    np.testing.assert_allclose(live.moment.qpos[0], turn.state.physics.qpos, atol=1e-6)
    assert sum(so_far for _, so_far in live.terms().values()) == pytest.approx(total, rel=1e-4)


def test_a_push_moves_what_is_pushed_and_is_gone_afterwards(live, scratch):
    ends = []
    for force in (0.0, 30.0):
        live.begin(3)
        push = live.unpushed.copy()
        push[scratch.model.body("right_forearm").id, 2] = force
        live.advance(20, push)
        ends.append(live.moment.qpos[0])
        assert not live._played.turn.state.physics.overrides
    assert np.abs(ends[0] - ends[1]).max() > 0.01


def test_the_pull_of_a_hand_is_a_force_at_its_point(scratch):
    """Against MuJoCo's own way from a force at a point to the joints."""
    import mujoco  # after assistax, which chooses how pictures are made

    model, data = scratch.model, mujoco.MjData(scratch.model)
    data.qpos = model.key("start").qpos
    mujoco.mj_forward(model, data)
    body = model.body("right_forearm").id
    point = data.xpos[body] + np.array([0.02, -0.03, 0.01])
    hand = Hand(model, body, data.qpos, point)
    hand.target = point + np.array([0.05, 0.02, 0.1])
    wanted, got, jac = np.zeros(model.nv), np.zeros(model.nv), np.zeros((6, model.nv))
    mujoco.mj_applyFT(model, data, STIFFNESS * (hand.target - point), np.zeros(3), point, body, wanted)
    mujoco.mj_jacBodyCom(model, data, jac[:3], jac[3:], body)
    got = jac.T @ hand.push(data.qpos)[body]
    np.testing.assert_allclose(got, wanted, atol=1e-4)
    hand.target = point + 10.0
    assert np.linalg.norm(hand.pull(data.qpos)[1]) == pytest.approx(STRONGEST)


def test_only_what_can_move_can_be_held(scratch):
    from assistax.evaluation.stage import Stage

    seen, model = Stage("scratch-v0").model, scratch.model
    held = {seen.body(i).name: held_by(seen, i, model) for i in range(seen.nbody)}
    assert held["right_forearm"] == model.body("right_forearm").id
    assert held["tool"] == model.body("tool").id
    assert held["world"] is held["target"] is held["furniture"] is None


@pytest.fixture(scope="module")
def browser(scratch):
    from assistax.viewer.browser import Browser

    def casting(name, settings):
        if "env.human.preference=sweep" in settings:
            raise UsageError("This team does not know preferences.")
        config = scratch.config
        if "env.human.disability=tremor" in settings:
            config = dataclasses.replace(config, human=dataclasses.replace(config.human, disability="tremor"))
        env = type(scratch)(scratch.name, "mujoco", config)
        return env, scripted_team(name, env)

    with Browser(casting, ["random", "still"], 3, port=free_port()) as found:
        yield found


def test_the_page_is_served_and_its_scene_moves(browser):
    """As a browser sees it: the page by HTTP, then messages by websocket."""
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    browser.again()
    with urllib.request.urlopen(browser.url) as page:
        assert b"viser" in page.read().lower()
    address = browser.url.replace("http", "ws")
    with connect(address, subprotocols=[Subprotocol(f"viser-v{viser.__version__}")], max_size=None) as client:
        arrived = []
        for _ in range(10):
            browser.tick(browser._then + 1 / 30)
            time.sleep(0.02)
        while len(arrived) < 5:
            arrived.append(client.recv(timeout=5))
    assert sum(map(len, arrived)) > 10_000  # the scene itself
    assert 15 <= browser.live.steps <= 20 or browser.live.over  # 10 frames of 1/30 s, and an episode of 0.16 s
    forearm = browser.scene.stage.model.body("right_forearm").id
    shown = next(handle for body, handle in browser.scene.handles() if body == forearm)
    before = np.array(shown.batched_wxyzs)
    browser.again()
    browser.tick(browser._then)
    assert np.abs(before - shown.batched_wxyzs).max() > 1e-4


def test_pause_step_speed_and_the_next_episode(browser):
    browser.again()
    browser.wish("step")
    browser.tick(browser._then + 0.05)
    assert browser.live.steps == 1 and not browser.playing
    browser.tick(browser._then + 0.05)
    assert browser.live.steps == 1
    for name, value in {"pause": (), "set_speed": (0.5,)}.items():
        browser.wish(name, *value)
    browser.tick(browser._then + 0.065)
    assert browser.live.steps == 5  # 4 more of 8 ms, in 65 ms at half speed
    browser.set_speed(1.0)
    seed = browser.live.seed
    browser.wish("next")
    browser.tick(browser._then)
    assert browser.live.seed == seed + 1 and browser.live.steps == 0


def test_what_is_told_is_the_caption_and_the_reward(browser):
    browser.again()
    browser._advance(3)
    browser.tick(browser._then)
    assert "no success yet" in browser.panel._told.content and "N, most" in browser.panel._told.content
    assert all(name.replace("_", " ") in browser.panel._terms.content for name in browser.live.terms())


def test_dragging_pulls_what_is_dragged(browser):
    browser.again()
    body = browser.live.env.model.body("right_forearm").id
    point = browser.scene.stage.data.body("right_forearm").xpos.copy()
    browser.wish("grab", body, point)
    browser.wish("pull", point + np.array([0.0, 0.0, 0.3]))
    browser.tick(browser._then + 0.05)
    assert browser.hand is not None and browser.scene._pull.visible
    browser.wish("release")
    browser.tick(browser._then)
    assert browser.hand is None and not browser.scene._pull.visible


def test_team_and_person_can_be_chosen_while_it_runs(browser):
    browser.wish("cast", Choice("random", preference="sweep"))
    browser.tick(browser._then)
    assert browser.panel.choice == browser.chosen == Choice("random")  # it does not fit, and all stays
    browser.wish("cast", Choice("still", disability="tremor"))
    browser.tick(browser._then)
    assert browser.chosen == Choice("still", disability="tremor")
    assert browser.live.env.config.human.disability == "tremor"
    browser.tick(browser._then + 0.05)
    assert browser.live.steps > 0


def test_castings_offer_every_team_of_a_task():
    casting, names = castings("scratch", None, "mujoco", ("env.episode_length=20", "env.human.disability=tremor"))
    assert names[:3] == ["trained", "still", "random"]
    env, team = casting("still", ("env.human.disability=weakness",))
    assert env.config.human.disability == "weakness" and env.episode_length == 20
    assert set(team) == {"robot", "human"}
    assert castings("scratch", "expert", None, ())[1][:2] == ["expert", "trained"]


def test_what_is_missing_is_one_line(monkeypatch, tmp_path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(UsageError, match=r"port \d+ .*--port"):
            view("scratch", port=taken.getsockname()[1])
    with pytest.raises(UsageError, match="from 1 to 65535"):
        view("scratch", port=0)
    with pytest.raises(UsageError, match=r"\*\.html"):
        view("scratch", html=tmp_path / "a.mp4")
    with pytest.raises(UsageError, match="does not exist"):
        view("scratch", html=tmp_path / "no" / "a.html")
    with pytest.raises(UsageError, match="one of --html and --native"):
        view("scratch", html=tmp_path / "a.html", native=True)
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(UsageError, match="no display"):
        view("scratch", native=True)
    monkeypatch.setattr(needs, "find_spec", lambda name: None)
    with pytest.raises(UsageError, match=r"assistax\[view\]"):
        view("scratch")


def test_a_page_plays_an_episode(tmp_path, scratch):
    from assistax.viewer.page import page

    page(scratch, scripted_team("random", scratch), 3, tmp_path / "episode.html")
    text = (tmp_path / "episode.html").read_text()
    assert "__VISER_EMBED_DATA__" in text
    assert text.rstrip().endswith("</html>")


@pytest.mark.slow
@pytest.mark.parametrize("what", ["live", "page"])
def test_in_a_real_browser(what, tmp_path):
    """The page opens, its scene moves, and nothing is wrong.

    Where there is a Chromium: uv run --with playwright pytest -m slow tests/test_viewer.py
    """
    sync_api = pytest.importorskip("playwright.sync_api")
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if program is None:
        pytest.skip("no browser here")
    env = assistax.make("scratch-v3", engine="mujoco", episode_length=500)
    team = scripted_team("expert", env)
    wrong, pictures = [], []
    graphics = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_api.sync_playwright() as play:
        chrome = play.chromium.launch(executable_path=program, args=["--no-sandbox", *graphics])
        tab = chrome.new_page(viewport={"width": 800, "height": 500})
        tab.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
        tab.on("pageerror", lambda error: wrong.append(str(error)))

        def look(frames):
            for _ in range(3):
                frames(3.0)
                pictures.append(
                    np.frombuffer(tab.screenshot(path=tmp_path / f"{len(pictures)}.png"), np.uint8).tobytes()
                )

        if what == "page":
            from assistax.viewer.page import page

            page(env, team, 0, tmp_path / "episode.html")
            tab.goto((tmp_path / "episode.html").as_uri())
            look(lambda seconds: tab.wait_for_timeout(1000 * seconds))
        else:
            from assistax.viewer.browser import Browser

            with Browser(lambda name, settings: (env, team), ["expert"], 0, port=free_port()) as browser:

                def frames(seconds):
                    end = time.perf_counter() + seconds
                    while (now := time.perf_counter()) < end:
                        browser.tick(now)
                        tab.wait_for_timeout(30)

                tab.goto(browser.url)
                look(frames)
        chrome.close()
    assert not wrong
    assert len(set(pictures)) == len(pictures)
