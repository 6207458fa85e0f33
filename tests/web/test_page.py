"""Every view of the page, by mouse and by keyboard, in front of real services and the models that ship."""

import base64
import re
import subprocess
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from tests.web.conftest import WEB, Stack, Watched, watch

VIEWS = (
    "/",
    "/?view=policy",
    "/?view=reward",
    "/?view=runs",
    "/?view=runs&start=run&kind=collect",
    "/?view=data",
    "/?view=data&show=models",
    "/?view=services",
)
WIDTHS = (320, 768, 1280)
FIRST_LOAD = 110_000
SEGMENTATION = "/services/segmentation/v1"
AXE = {  # what only depends on colours is looked for in both schemes, all else in one
    "light": "{ preload: false, runOnly: ['wcag2a', 'wcag2aa', 'wcag21aa', 'wcag22aa'], resultTypes: ['violations'] }",
    "dark": "{ preload: false, runOnly: ['color-contrast', 'link-in-text-block'], resultTypes: ['violations'] }",
}

pytestmark = pytest.mark.e2e


def post(stack: Stack, path: str, body: dict[str, Any]) -> Any:
    reply = httpx.post(stack.url + path, json=body, timeout=60)
    assert reply.status_code == 200, reply.text
    return reply.json()


def get(stack: Stack, path: str, **query: Any) -> Any:
    return httpx.get(stack.url + path, params=query, timeout=60).json()


@pytest.fixture(scope="module")
def demos(stack: Stack, wait_until: Callable[..., float]) -> str:
    """A dataset of the grid world, recorded by a run."""
    config = {"task": "grid", "dataset": "demos", "count": 12}
    run = post(stack, "/v1/start-run", {"kind": "collect", "config": config})["run"]
    wait_until(lambda: get(stack, "/v1/get-run", id=run["id"])["run"]["state"] == "succeeded", 60)
    return "demos"


def test_the_types_of_the_api_are_those_of_its_services(stack: Stack, node: str, tmp_path: Path) -> None:
    command = [node, "tools/types.mjs", stack.url, str(tmp_path / "types.ts")]
    subprocess.run(command, cwd=WEB, check=True, capture_output=True, timeout=60)
    stale = "The types are stale: run `npm run types URL` in web/"
    assert (tmp_path / "types.ts").read_text() == (WEB / "src/api/types.ts").read_text(), stale


def test_the_first_screen_is_a_segmented_demonstration(watched: Watched) -> None:
    page = watched.open("/")
    bar = page.get_by_role("slider", name="Time")
    bar.wait_for()
    sizes = page.evaluate("performance.getEntriesByType('resource').map(each => [each.name, each.transferSize])")
    first = sum(size for name, size in sizes if name.endswith((".js", ".css")))
    assert 0 < first < FIRST_LOAD
    assert "move-cereal" in page.get_by_role("region", name="Segments").get_by_label("Skill of segment 2").input_value()


def test_time_is_in_the_url_and_moves_by_keys_and_mouse(watched: Watched, wait_until: Callable[..., float]) -> None:
    page = watched.open("/?t=7.1")
    bar = page.get_by_role("slider", name="Time")
    assert bar.get_attribute("aria-valuenow") == "28"
    bar.focus()
    for key in ("ArrowRight", "Shift+ArrowRight", "PageUp"):
        bar.press(key)
    assert bar.get_attribute("aria-valuenow") == "28"
    bar.press("PageDown")
    assert "move-bread" in bar.get_attribute("aria-valuetext")
    page.wait_for_url("**t=15")
    box = bar.bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + 20)
    page.wait_for_url("**t=10")
    page.reload()
    assert bar.get_attribute("aria-valuenow") == "40"
    page.get_by_role("link", name="Services", exact=True).click()
    page.get_by_role("heading", name="Services").wait_for()
    page.go_back()
    assert bar.get_attribute("aria-valuenow") == "40"
    page.get_by_role("button", name="Play").click()
    wait_until(lambda: int(bar.get_attribute("aria-valuenow")) > 41, 20)


def test_segments_are_edited_by_keys_and_by_mouse_and_taken_away(watched: Watched) -> None:
    page = watched.open("/?t=7")
    bar = page.get_by_role("slider", name="Time")
    begin = page.get_by_label("Begin of segment 3")
    bar.press("Alt+ArrowLeft")
    assert begin.input_value() == "27"
    box = bar.bounding_box()
    at = box["x"] + box["width"] * 27 / 80
    page.mouse.move(at, box["y"] + 40)
    page.mouse.down()
    page.mouse.move(at + box["width"] * 3 / 80, box["y"] + 40, steps=5)
    page.mouse.up()
    assert begin.input_value() == "30"
    bar.press("Home")
    for _ in range(3):
        bar.press("ArrowRight")
    bar.press("Enter")
    page.get_by_label("Skill of segment 2").fill("move-can")
    page.get_by_label("Skill of segment 2").press("Tab")
    with page.expect_download() as saved:
        page.get_by_role("button", name="Save WebVTT").click()
    text = Path(saved.value.path()).read_text()
    assert text.startswith(
        "WEBVTT\n\n00:00:00.000 --> 00:00:00.750\nmove-bread\n\n00:00:00.750 --> 00:00:01.500\nmove-can"
    )
    with page.expect_download() as saved:
        page.get_by_role("button", name="Save CSV").click()
    assert "0,6,30,move-cereal\n" in Path(saved.value.path()).read_text()
    bar.focus()
    for _ in range(4):
        bar.press("Control+z")
    assert begin.input_value() == "28"
    assert page.get_by_role("button", name="Undo").is_disabled()


def test_what_is_typed_is_taken_once_it_is_complete(watched: Watched, demos: str) -> None:
    page = watched.open("/")
    begin = page.get_by_label("Begin of segment 3")
    begin.press("Control+a")
    begin.press_sequentially("25")
    begin.press("Enter")
    assert begin.input_value() == "25"
    page.get_by_role("button", name="Undo").click()
    assert begin.input_value() == "28"
    assert page.get_by_role("button", name="Undo").is_disabled()
    watched.open(f"/?source=dataset&dataset={demos}")
    trajectory = page.get_by_label("Trajectory, 0 to 11")
    trajectory.press("Control+a")
    trajectory.press_sequentially("11")
    page.get_by_role("heading", name="demos, trajectory 0").wait_for()
    page.keyboard.press("Enter")
    page.get_by_role("heading", name="demos, trajectory 11").wait_for()


def test_edits_that_are_not_saved_are_there_when_one_comes_back(watched: Watched, demos: str) -> None:
    page = watched.open(f"/?source=dataset&dataset={demos}")
    skill = page.get_by_label("Skill of segment 1")
    skill.fill("pick-purple")
    skill.press("Tab")
    page.get_by_label("Trajectory, 0 to 11").fill("1")
    page.get_by_label("Trajectory, 0 to 11").press("Enter")
    page.get_by_role("heading", name="demos, trajectory 1").wait_for()
    page.get_by_role("link", name="Services", exact=True).click()
    page.get_by_role("heading", name="Services").wait_for()
    page.get_by_role("link", name="Segments", exact=True).click()
    page.get_by_role("link", name="A dataset").click()
    page.get_by_role("heading", name="demos, trajectory 0").wait_for()
    assert skill.input_value() == "pick-purple"
    page.locator("select[name=model]").select_option("grid")
    page.get_by_role("button", name="Segment", exact=True).click()
    page.get_by_text("and model grid").wait_for()
    page.get_by_role("button", name="Undo").click()
    assert skill.input_value() == "pick-purple"


def test_a_trajectory_of_a_dataset_is_segmented_and_its_labels_saved(watched: Watched, demos: str) -> None:
    page = watched.open("/?view=data")
    page.get_by_role("link", name="Look at its trajectories").click()
    page.get_by_label("Trajectory, 0 to 11").fill("3")
    page.get_by_label("Trajectory, 0 to 11").press("Tab")
    page.get_by_role("heading", name="demos, trajectory 3").wait_for()
    page.locator("select[name=model]").select_option("grid")
    page.get_by_role("button", name="Segment", exact=True).click()
    page.get_by_text("by model grid").wait_for()
    page.get_by_label("Skill of segment 1").fill("pick-purple")
    page.get_by_label("Skill of segment 1").press("Tab")
    page.get_by_role("button", name="Save as labels of demos").click()
    page.get_by_role("button", name="Saved").wait_for()
    page.reload()
    page.get_by_text("by a person", exact=True).wait_for()
    assert page.get_by_label("Skill of segment 1").input_value() == "pick-purple"


def test_a_dropped_video_is_segmented(
    watched: Watched, stack: Stack, demos: str, encode_video: Callable[..., bytes], tmp_path: Path
) -> None:
    trajectory = get(stack, "/v1/get-trajectory", dataset=demos, index=0)
    actions = np.frombuffer(base64.b64decode(trajectory["actions"]["raw"]), np.int64)
    frames = np.full((len(actions), 66, 60, 3), 40, np.uint8)
    (tmp_path / "grid.mp4").write_bytes(encode_video(frames, fps=10))
    (tmp_path / "actions.csv").write_text("action\n" + "".join(f"{each}\n" for each in actions))
    page = watched.open("/?source=video")
    page.get_by_label("Video (mp4").set_input_files(tmp_path / "grid.mp4")
    page.locator("select[name=model]").select_option("grid")
    page.get_by_label("Executed actions").set_input_files(tmp_path / "actions.csv")
    page.get_by_role("button", name="Segment", exact=True).click()
    page.get_by_role("heading", name="grid.mp4").wait_for()
    assert page.get_by_role("slider", name="Time").get_attribute("aria-valuemax") == str(len(actions) - 1)
    page.get_by_text("unlike the training data").first.wait_for()
    page.get_by_role("link", name="Demonstration", exact=True).click()
    page.get_by_role("heading", name="A robot sorts groceries").wait_for()
    page.get_by_role("link", name="Your video").click()
    page.get_by_role("heading", name="grid.mp4").wait_for()
    page.get_by_role("slider", name="Time").press("End")
    assert page.get_by_text("This frame cannot be shown").count() == 0


def test_a_run_is_started_from_its_form_watched_and_its_artifacts_shown(watched: Watched) -> None:
    page = watched.open("/?view=runs&start=run&kind=collect")
    page.get_by_label("count").fill("2.5")
    page.get_by_role("button", name="Start").click()
    page.get_by_text("task is needed.").wait_for()
    page.get_by_text("count must be a whole number; got “2.5”.").wait_for()
    page.get_by_label("task").fill("grid")
    page.get_by_label("dataset").fill("walks")
    page.get_by_label("count").fill("5")
    page.get_by_label("behaviour").select_option("random")
    page.get_by_role("button", name="Start").click()
    page.locator(".job-head .state", has_text="succeeded").wait_for()
    page.get_by_role("img", name=re.compile("timesteps: .* points to step 5")).wait_for()
    page.get_by_role("link", name="dataset.json").wait_for()
    page.get_by_role("link", name="All runs and fits").click()
    page.get_by_label("Filter").fill("walks")
    assert page.locator("table.jobs tbody tr").count() == 1


def test_a_fit_that_is_watched_survives_the_orchestrator(
    interrupted: Watched, stack: Stack, demos: str, wait_until: Callable[..., float]
) -> None:
    page = interrupted.open(f"/?view=runs&start=fit&dataset={demos}")
    page.get_by_label("model_name").fill("small")
    for key, value in {"steps": "4000", "batch_size": "4", "log_every": "1", "checkpoint_every": "20"}.items():
        if not page.get_by_label(key, exact=True).is_visible():
            page.get_by_text("more keys").click()
        page.get_by_label(key, exact=True).fill(value)
    page.get_by_role("button", name="Start").click()
    curve = page.get_by_role("img", name=re.compile("train_loss: "))
    curve.wait_for()
    stack.kill("orchestrator")
    page.get_by_text("The orchestrator does not answer.").first.wait_for()
    stack.restart("orchestrator")
    before = points(curve)
    wait_until(lambda: points(curve) > before, 20)
    page.get_by_role("button", name="Cancel").click()
    page.locator(".job-head .state", has_text="cancelled").wait_for()
    fit = page.url.partition("job=segmentation%2F")[2]

    def recorded() -> int:
        metrics = get(stack, f"{SEGMENTATION}/get-fit-metrics", id=fit, max_rows=1)
        return int(metrics["total_rows"])

    wait_until(lambda: points(curve) == recorded(), 20)
    page.get_by_role("button", name="Resume").click()
    page.locator(".job-head .state", has_text="running").wait_for()
    page.get_by_text(re.compile("step \\d+: resumed")).wait_for()
    page.get_by_role("button", name="Cancel").click()
    page.locator(".job-head .state", has_text="cancelled").wait_for()


def points(curve: Any) -> int:
    found = re.search(r"(\d+) points", curve.get_attribute("aria-label"))
    return int(found[1]) if found else 0


def test_two_jobs_are_compared(watched: Watched, demos: str) -> None:
    page = watched.open("/?view=runs")
    page.get_by_role("button", name="Compare collect grid → demos").click()
    page.get_by_role("link", name="with chosen").first.click()
    page.get_by_role("link", name="Compare no longer").wait_for()
    page.get_by_text("Configuration", exact=True).click()
    page.get_by_role("columnheader", name="Compared").wait_for()


def test_a_sentence_is_rewarded_over_time_and_its_phrases_found(watched: Watched) -> None:
    page = watched.open("/?view=reward")
    page.get_by_text("The goal fits best:").wait_for()
    page.get_by_role("img", name="Heatmap of a yellow block").wait_for()
    page.get_by_text(re.compile("there with (0.9|1.0)")).first.wait_for()
    page.get_by_role("slider", name="image").press("Home")
    page.get_by_text("A rival fits better:").wait_for()
    page.get_by_label("Goal in words").fill("put <img src=x onerror=alert(1)> on the sponge")
    page.get_by_role("button", name="Reward").click()
    page.locator(".sentence u", has_text="sponge").wait_for()
    assert "<img src=x" in page.locator(".sentence p").first.inner_text()


def test_a_policy_acts_towards_goal_images_and_a_new_goal(watched: Watched, stack: Stack) -> None:
    page = watched.open("/?view=policy")
    page.get_by_role("spinbutton", name="Goal images").fill("2")
    page.get_by_role("button", name="Give the expert's images").click()
    page.get_by_role("button", name="Step").click()
    page.get_by_text("1 steps").wait_for()
    page.get_by_role("button", name="Act").click()
    page.get_by_text(re.compile("Holding")).first.wait_for()
    page.get_by_label("What the expert would do").select_option("move-blue")
    page.get_by_role("button", name="Give the expert's images").click()
    page.get_by_role("button", name="Act").click()
    page.get_by_text(re.compile("Acting, [1-9]")).wait_for()
    page.get_by_role("button", name="Pause").click()
    page.get_by_text("The same calls by hand").click()
    session = re.search(r'"session":"(\w+)"', page.get_by_role("region", name="Step with curl").inner_text())
    assert session is not None
    page.close(run_before_unload=False)
    reply = httpx.post(f"{stack.url}/services/sim/v1/render", json={"session": session[1]}, timeout=60)
    assert reply.json()["code"] == "session_not_found"


def test_a_world_is_kept_while_its_page_is_seen(watched: Watched) -> None:
    watched.page.clock.install()
    page = watched.open("/?view=policy")
    page.get_by_text("Give it a goal").wait_for()
    with page.expect_response("**/sim/v1/render") as renewed:
        page.clock.fast_forward("00:41")
    assert renewed.value.ok


def test_a_policy_executes_a_recipe(watched: Watched) -> None:
    page = watched.open("/?view=policy&model=skills")
    page.get_by_role("button", name="Remove move-green, skill 2").click()
    page.get_by_role("button", name="Give this recipe").click()
    page.get_by_text("Ready to act.").wait_for()
    page.get_by_role("button", name="Act").press("Enter")
    page.get_by_text(re.compile("Holding")).first.wait_for()


def test_models_have_cards_and_an_earlier_version_is_activated(
    watched: Watched, stack: Stack, demos: str, wait_until: Callable[..., float]
) -> None:
    small = {"steps": 2, "batch_size": 2, "features": 8, "hidden_size": 16, "augmentation": 0}
    fit = post(stack, f"{SEGMENTATION}/start-fit", {"dataset": demos, "model_name": "grid", "config": small})["fit"]
    wait_until(lambda: get(stack, f"{SEGMENTATION}/get-fit", id=fit["id"])["fit"]["state"] == "succeeded", 60)
    page = watched.open("/?view=data&show=models")
    shipped = page.get_by_role("region", name=re.compile("^grid")).filter(has_text="comes with freerein")
    shipped.get_by_text("Whole card").click()
    shipped.get_by_role("region", name="Card").get_by_text("frame_accuracy").wait_for()
    shipped.get_by_role("button", name="Activate grid").click()
    shipped.get_by_text("active", exact=True).wait_for()
    assert page.get_by_role("button", name="Activate grid").count() == 1


def test_a_service_that_is_away_is_named_and_comes_back(interrupted: Watched, stack: Stack) -> None:
    page = interrupted.open("/?view=services")
    card = page.get_by_role("region", name="sim")
    card.get_by_text("ready", exact=True).wait_for()
    stack.kill("sim")
    card.get_by_text("Nobody answers.").wait_for()
    page.get_by_role("link", name="sim away").wait_for()
    page.get_by_role("link", name="Policy").click()
    page.get_by_role("alert").get_by_text("Away").wait_for()
    stack.restart("sim")
    page.get_by_role("button", name="Give the expert's images").click()
    page.get_by_role("button", name="Act").click()
    page.get_by_text(re.compile("Acting, [1-9]")).wait_for()
    stack.kill("imitation")
    page.get_by_role("alert").get_by_text("Away").wait_for()
    stack.restart("imitation")
    page.get_by_role("button", name="Try again").click()
    page.get_by_text("Give it a goal").wait_for()


def test_a_token_is_taken_once(browser: Any, start_service: Callable[..., Any]) -> None:
    service = start_service("freerein_orchestrator", FREEREIN_TOKEN="a-secret").until_ready()
    watched = watch(browser, service.url)
    page = watched.open("/?view=runs")
    page.get_by_label("Token").fill("another")
    page.get_by_role("button", name="Sign in").click()
    page.get_by_role("alert").wait_for()
    page.get_by_label("Token").fill("a-secret")
    page.get_by_role("button", name="Sign in").click()
    page.get_by_text("No runs and no fits yet").wait_for()
    page.reload()
    page.get_by_text("No runs and no fits yet").wait_for()
    assert page.evaluate("document.cookie") == ""
    page.context.close()


def test_no_view_has_a_barrier(watched: Watched, demos: str, node: str, wait_until: Callable[..., float]) -> None:
    axe = (WEB / "node_modules/axe-core/axe.min.js").read_text()
    page, found = watched.page, []
    for view in (*VIEWS, f"/?source=dataset&dataset={demos}"):
        watched.open(view)
        page.locator("h1").wait_for()
        wait_until(lambda: page.locator(".loading").count() == 0, 30)
        page.evaluate(axe)
        for scheme, width in product(AXE, WIDTHS):
            page.emulate_media(color_scheme=scheme, reduced_motion="reduce")
            page.set_viewport_size({"width": width, "height": 900})
            violations = page.evaluate(f"axe.run({AXE[scheme]}).then(result => result.violations)")
            found += [(view, scheme, width, each["id"], each["nodes"][0]["html"]) for each in violations]
            wide = page.evaluate("document.documentElement.scrollWidth")
            found += [(view, scheme, width, "scrolls sideways", str(wide))] if wide > width else []
    assert found == []
