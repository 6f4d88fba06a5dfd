"""Pictures by a volume's own methods. The renderer lies floors above volumes: it is imported when it is first used."""

from __future__ import annotations

from importlib import import_module
from typing import Any

__all__ = ["Pictured"]


class Pictured:
    """The methods `render` and `plot`."""

    def render(self, *arguments: Any, **options: Any) -> Any:
        """One picture: ``clvol.render(volume, camera, mode, size, step, **options)``, whose arguments it takes.

        Returns
        -------
        Picture, or dict of str to Picture
            As `clvol.render`.

        Raises
        ------
        ClvolError
            As by `clvol.render`.

        Examples
        --------
        >>> import clvol
        >>> volume = clvol.phantoms.marschner_lobb(16)
        >>> volume.render(clvol.Camera.orbit(40, 10), "mip", (30, 20)).shape
        (20, 30, 4)
        """
        return import_module("clvol.march.renderer").render(self, *arguments, **options)

    def plot(self, *arguments: Any, **options: Any) -> None:
        """Render a picture and show it: ``clvol.show(volume.render(...))``, in a notebook below the cell.

        Raises
        ------
        ClvolError
            As by `clvol.render` and `clvol.show`.
        """
        import_module("clvol.show.picture").show(self.render(*arguments, **options))
