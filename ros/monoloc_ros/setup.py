"""Installs the node; the package monoloc itself comes by pip."""

from setuptools import setup

NAME = "monoloc_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/monoloc.launch.xml"]),
    ],
    install_requires=["setuptools"],
    license="MIT",
    description="Publishes the pose of a camera in a room that monoloc has a bundle of.",
    entry_points={"console_scripts": ["node = monoloc_ros.node:main"]},
)
