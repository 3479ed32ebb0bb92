"""Certification from options to files: checks, certificate, page, figures."""

import argparse
from pathlib import Path

from rich.console import Console
from rich.text import Text

from ampc_ros.certificate import certify_command
from ampc_ros.configuration import Choices
from launch_scripts.certifying.certificate import (
    SHIPPED_FOLDER,
    Result,
    certify,
    default_folder,
    driven_seconds,
    file_name,
    loop_speeds,
    to_document,
    to_text,
)
from launch_scripts.certifying.page import bounds_table, figures, page, results_table, rows_of
from launch_scripts.certifying.subject import Subject, load_subject
from launch_scripts.reporting.pages import terminal_table
from launch_scripts.reporting.style import save_png
from launch_scripts.run.options import create_folder, naming, print_vehicle_warnings
from launch_scripts.run.progress import show_progress
from launch_scripts.tuning.search import write_atomically

SHIPPED = (
    Choices(vehicle="paper", gain_table="preview_paper"),
    Choices(vehicle="ordinary", gain_table="preview_ordinary"),
    *(Choices(vehicle=car, gain_table="preview") for car in ("paper", "ordinary")),
    *(
        Choices(vehicle=car, settings=f"{rate}hz", gain_table=f"preview_{rate}hz")
        for rate in (50, 100)
        for car in ("paper", "ordinary")
    ),
    *(Choices("paper", vehicle=car, gain_table="table3") for car in ("paper", "ordinary")),
    Choices("paper", vehicle="paper", gain_table="paper_pso"),
)
"""Shipped tables with the shipped vehicles for which they are meant."""
PACKAGE_PAGES = Path("runs/certify")
"""Folder of the page where the certificate is written into the package."""
OTHER_FOLDER = "choose another folder with --output"


def certify_chosen(chosen: argparse.Namespace, console: Console) -> bool:
    """Certify a table or all shipped ones, write the files; return whether all hold.

    Raises:
        ValueError: Names option or file, key, value and bound.
    """
    if chosen.workers < 1:
        raise ValueError(f"--workers {chosen.workers}: must be at least 1")
    if chosen.shipped:
        certify_shipped(chosen.output or SHIPPED_FOLDER, chosen.workers, console)
        return True
    options = chosen.controller, chosen.vehicle, chosen.settings, chosen.gain_table
    subject = load_subject(Choices(*options))
    print_vehicle_warnings(chosen.vehicle, console)
    folder = chosen.output or default_folder(subject)
    with naming("output"):
        create_folder(folder, exist_ok=True)
    result = run_checks(subject, chosen.workers, console)
    file = write(result, folder)
    command = certify_command(subject.choices, subject.gain_table)
    page_folder = PACKAGE_PAGES if folder == SHIPPED_FOLDER else folder
    table_page = page_folder / file.with_suffix(".html").name
    write_atomically(table_page, page(result, command, file.name), OTHER_FOLDER)
    if chosen.figures:
        write_figures(result, chosen.figures)
    heads = ("quantity", "bound", "worst", "at", "speeds within", "")
    console.width = max(console.width, 120)
    console.print(terminal_table(heads, [row[:6] for row in rows_of(result)], "lrrrrl"))
    print_verdict(result, console)
    console.print(f"written: {file} and {table_page}", markup=False)
    return result.certified


def run_checks(subject: Subject, threads: int, console: Console) -> Result:
    """Certify with progress.

    Raises:
        ValueError: Names file, key, value and bound.
    """
    name = f"certify {subject.gain_table.stem} for {Path(subject.choices.vehicle).stem}"
    speeds = loop_speeds(subject)
    total = driven_seconds(subject, speeds) if len(speeds) else 1.0
    with show_progress(console, name, total) as advance:
        return certify(subject, threads, advance)


def write(result: Result, folder: Path) -> Path:
    """Write the certificate and return its file.

    Raises:
        ValueError: The file cannot be written.
    """
    file = folder / file_name(result.subject)
    write_atomically(file, to_text(to_document(result)), OTHER_FOLDER)
    return file


def write_figures(result: Result, folder: Path) -> None:
    """Write the figures of the page as PNG.

    Raises:
        ValueError: The folder cannot be created.
    """
    with naming("figures"):
        create_folder(folder, exist_ok=True)
    for name, figure in figures(result).items():
        save_png(figure, folder / f"certificate_{name}.png")


def print_verdict(result: Result, console: Console) -> None:
    """Print whether the table is certified, and what does not hold."""
    for failure in result.failures:
        console.print(Text.assemble(("fails:", "red"), f" {failure}"))
    for v in result.out_of_reach:
        console.print(f"not driven: {v:g} m/s, the car does not reach this speed")
    verdict = "certified" if result.certified else "not certified"
    names = f"{result.subject.gain_table.stem} for {result.subject.choices.vehicle}"
    console.print(f"{names}: {verdict}", markup=False)


def certify_shipped(folder: Path, threads: int, console: Console) -> None:
    """Certify every shipped table, certified or not, and print the tables of its page.

    Raises:
        ValueError: A file cannot be read or written.
    """
    documents = []
    for choices in SHIPPED:
        result = run_checks(load_subject(choices), threads, console)
        documents.append(to_document(result))
        write(result, folder)
    console.print("\n".join([*bounds_table(), "", *results_table(documents)]), markup=False)
