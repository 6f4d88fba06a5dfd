"""Commands that list what there is: filters, modes, devices, and the script for completion."""

from __future__ import annotations

@app.command
def devices(*, json: Json = False) -> None:
    """List the OpenCL devices, the one used by default first."""
    rows = [
        {
            "number": i,
            "name": d.name,
            "kind": d.kind,
            "platform": d.platform,
            "memory_mib": d.handle.global_mem_size >> 20,
            "images": bool(d.handle.image_support),
        }
        for i, d in enumerate(clvol.devices())
    ]
    if not rows:
        from clvol.device import as_device

        as_device()  # raises, and says what to install
    if json:
        print_json(rows)
    else:
        header = ["number", "name", "kind", "platform", "memory_mib", "images"]
        table(header, [[str(row[key]) for key in header] for row in rows])


@app.command
def filters(*, json: Json = False) -> None:
    """List the reconstruction filters."""
    table = clvol.filters()
    if json:
        print_json([dict(zip(table.HEADER, row, strict=True)) for row in table.rows()])
    else:
        table(list(table.HEADER), [list(row) for row in table.rows()])
