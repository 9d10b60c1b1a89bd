"""Nodes that were put into somebody's tree, and out again."""

from __future__ import annotations

from collections.abc import Iterable

import bpy


def remove_nodes(tree: bpy.types.NodeTree, names: Iterable[str]) -> None:
    """Remove the nodes of these ``names`` that are in ``tree``, and their node groups that nothing else uses."""
    nodes = [tree.nodes[name] for name in names if name in tree.nodes]
    groups = {node.node_tree for node in nodes if node.bl_idname == "CompositorNodeGroup"}
    for node in nodes:
        tree.nodes.remove(node)
    for group in groups:
        if not group.users:
            bpy.data.node_groups.remove(group)
