"""What the steps share: places in Blender's interface, pictures, renders, the measurement of gaps."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .session import Session, until

ADDON = "bl_ext.user_default.iris"
PREFERENCES = (150, 60, 1150, 800)
TOP_BAR_Y = 13
EDIT_X, RENDER_X = 80, 128  # menus of the top bar
ADD_X = 266  # menu "Add" in the header of the 3D view
OWN_SECONDS = 0.1  # the longest that code of the extension may keep the main thread
IDLE_SECONDS = 4.0


@dataclass
class Stage:
    """A Blender, the folder of pictures, and figures to report."""

    session: Session
    pictures: Path
    figures: dict[str, str] = field(default_factory=dict)

    # ---- see ---------------------------------------------------------------------------------------------------------

    def photograph(self, name: str) -> None:
        """Keep the screen as NAME.png, once it stands still."""
        self.session.display.still().save(self.pictures / f"{name}.png")

    def photograph_at_once(self, name: str) -> None:
        """Keep the screen as it is now."""
        self.session.display.look().save(self.pictures / f"{name}.png")

    def value(self, path: str) -> object:
        """A value below the scene, e.g. ``iris.preset``."""
        return self.session.ask(f"bpy.context.window_manager.windows[0].scene.{path}")

    def difference(self, before: dict) -> str:
        """In which way the file is another one now."""
        now = self.session.ask("content()")
        return "\n".join(
            f"{key}: {before.get(key)} is {now.get(key)}" for key in before | now if before.get(key) != now.get(key)
        )

    # ---- preferences -------------------------------------------------------------------------------------------------

    def open_preferences(self) -> None:
        """Edit > Preferences, in a window of their own."""
        session = self.session
        session.new_window(lambda: session.choose(EDIT_X, TOP_BAR_Y, -1), "Preferences", PREFERENCES)

    def preferences_section(self, section: str) -> None:
        """Click through the sections until it is reached."""
        # Blender 5 has the list of sections in a sidebar.
        name = "NAVIGATION_BAR" if self.session.ask("bpy.app.version[0]") < 5 else "UI"
        left, top, width, height = self.session.region("PREFERENCES", name, 1)
        for y in range(top + 15, top + height, 20):
            self.session.display.click(left + width / 2, y)
            if self.session.ask("bpy.context.preferences.active_section") == section:
                self.session.display.still()
                return
        raise AssertionError(f"no section {section} in the preferences")

    def set_solver(self, python: str) -> None:
        """Open the extension's preferences, below its name in the list, and type the path."""
        session = self.session
        if session.find("iris.test_python", "PREFERENCES", "WINDOW", 1, (0.3,)) is None:
            session.press(f"addon_expand(module='{ADDON}')", "PREFERENCES", "WINDOW", 1, (0.03,))
            session.display.still()
        x, y = session.scroll_to("iris.test_python", "PREFERENCES", "WINDOW", 1, (0.3,))
        left, _top, width, _height = session.region("PREFERENCES", "WINDOW", 1)
        x = left + 0.6 * width
        field_y = next(above for above in range(int(y) - 14, int(y) - 60, -3) if session.hovered(x, above, 1))
        session.type_into((x, field_y - 6), python)
        assert session.ask(f"bpy.context.preferences.addons[{ADDON!r}].preferences.python") == python

    def open_every_section(self) -> None:
        """The steps press buttons of every section; tests/blender/test_solved_demo.py has which one is open."""
        self.session.ask(f"setattr(bpy.context.preferences.addons[{ADDON!r}].preferences, 'fold_steps', False)")

    def show_sidebar(self) -> None:
        """The sidebar of a file that was saved with it open, at its tab."""
        until(lambda: self.session.ask("sidebar_tab()") == "IRIS", "the sidebar is where it was", 20)

    # ---- scene -------------------------------------------------------------------------------------------------------

    def undo(self) -> None:
        """Edit > Undo."""
        self.session.choose(EDIT_X, TOP_BAR_Y, 0)
        self.session.display.still()

    def redo(self) -> None:
        """Edit > Redo."""
        self.session.choose(EDIT_X, TOP_BAR_Y, 1)
        self.session.display.still()

    def hide_the_cube(self) -> None:
        """The cube and the light of the start-up file do not belong to the room."""
        for name in ("Cube", "Light"):
            self.session.ask(f"bpy.data.objects.remove(bpy.data.objects[{name!r}])")

    def press_for_window(self, name: str, title: str, picture: str, columns: tuple[float, ...] = (0.5,)) -> None:
        """Press twice a button that shows something in the editor called ``title``: a window opens for it, once, and
        the editors of the first window stay what they were. Then that window is closed."""
        session = self.session
        before, count = self.editors(), session.windows()
        session.new_window(lambda: session.press(name, columns=columns), title, (0, 560, 560, 400))
        self.photograph(picture)
        session.press(name, columns=columns)
        session.display.still()
        assert session.windows() == count + 1, f"{name} opened another window"
        assert self.editors() == before, f"{name} made {before} into {self.editors()}"
        session.close_newest_window()

    def editors(self) -> list[str]:
        """Types of the editors in the first window."""
        return [area["type"] for area in self.session.ask("windows()")[0]["areas"]]

    def render(self, name: str) -> list[float]:
        """Render > Render Image, small, through the camera that is looked through; means of its channels."""
        session = self.session
        session.ask("small_render()")
        session.new_window(lambda: session.choose(RENDER_X, TOP_BAR_Y, 0), "Render", (250, 120, 900, 700))
        until(lambda: not session.ask("bpy.app.is_job_running('RENDER')"), "the render ends", 300)
        self.photograph(name)
        means = session.ask(f"rendered('{session.root.HOME}/{name}.png')")
        session.close_newest_window()
        return means

    # ---- does the interface answer -----------------------------------------------------------------------------------

    def idle_gaps(self) -> None:
        """Measure what redraws alone cost: the mouse moves over the panel for some seconds, nothing runs."""
        session = self.session
        session.ask("monitor.take() and None")
        left, top, width, height = session.region("VIEW_3D", "UI")
        for part in np.linspace(0.1, 0.9, 20):
            session.display.move(left + width / 2, top + part * height)
        self.figures["gaps without a solve"] = gap_line(session.ask("monitor.take()")["gaps"])

    def judge_gaps(self) -> None:
        """Report the gaps since the last time, and fail where the extension's own code kept the main thread."""
        taken = self.session.ask("monitor.take()")
        self.figures["gaps during a solve"] = gap_line(taken["gaps"])
        slowest = sorted(taken["calls"], reverse=True)[:3]
        assert slowest, "nothing of the extension ran: the measurement is broken"
        where = ", ".join(f"{1000 * seconds:.0f} ms {name.rpartition('/')[2]}" for seconds, name in slowest)
        self.figures["longest in the extension"] = where
        assert slowest[0][0] < OWN_SECONDS, f"the extension kept the main thread: {where}"


def gap_line(gaps: list[float]) -> str:
    """Median, 99th percentile and maximum in milliseconds."""
    milliseconds = 1000 * np.asarray(gaps)
    middle, high = np.percentile(milliseconds, (50, 99))
    return f"median {middle:.0f}, 99 % {high:.0f}, longest {milliseconds.max():.0f} ms ({len(gaps)} ticks)"
