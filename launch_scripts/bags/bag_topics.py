"""What a bag announces, without reading its messages."""

from pathlib import Path

from mcap.reader import make_reader

from launch_scripts.bags.bag import check, files, plain, whole


def topics(bag: Path) -> dict[str, str]:
    """Give the topics of a bag and their types, such as `nav_msgs/msg/Odometry`.

    Raises:
        ValueError: One line that names the file: there is no bag, or it cannot be understood.
    """
    found: dict[str, str] = {}
    for file in files(bag):
        check(file)
        try:
            found |= announced(file)
        except Exception as error:  # what a damaged byte makes the libraries raise has no end
            reason = " ".join(str(error).split()) or "it ends early"
            raise ValueError(f"{file}: damaged or foreign: {reason}") from error
    return found


def announced(file: Path) -> dict[str, str]:
    """Give topics and types of one file: its index tells, and what is cut off gets one."""
    with whole(plain(file)) as stream:
        summary = make_reader(stream).get_summary()
        if summary is None or not summary.channels:
            stream.seek(0)
            messages = make_reader(stream).iter_messages(log_time_order=False)
            return {channel.topic: schema.name for schema, channel, _ in messages if schema}
    names = {key: schema.name for key, schema in summary.schemas.items()}
    channels = summary.channels.values()
    return {channel.topic: names.get(channel.schema_id, "") for channel in channels}
