"""A Hub in memory: the routes that uploading, tagging and downloading need, on a local port."""

import base64
import hashlib
import json
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler
from typing import Any
from urllib.parse import unquote, urlsplit

from tests.tools import served

TOKEN = "hf_secretsecretsecret"
REGULAR = (".md", ".json", ".yaml", ".svg", ".py", ".txt")
"""Suffixes of files that are stored in git; all others go to the large file storage."""
INITIAL = "0" * 39 + "1"


@dataclass
class Repo:
    """A repository: its commits, oldest first, and its tags."""

    private: bool
    commits: dict[str, dict[str, bytes]] = field(default_factory=lambda: {INITIAL: {}})
    tags: dict[str, str] = field(default_factory=dict)

    @property
    def head(self) -> str:
        return list(self.commits)[-1]

    @property
    def files(self) -> dict[str, bytes]:
        return self.commits[self.head]


@dataclass
class Hub:
    """What the server holds, and how it fails."""

    repos: dict[str, Repo] = field(
        default_factory=dict
    )  # by ``datasets/user/name`` or ``models/user/name``
    blobs: dict[str, bytes] = field(default_factory=dict)  # the large file storage, by sha256
    uploads_left: int | None = None  # how many more large files are taken; None for no end
    requests: list[str] = field(default_factory=list)  # every request line
    url: str = ""


class RefusalError(Exception):
    def __init__(self, status: int, code: str = "", message: str = "", **details: str) -> None:
        self.status = status
        self.code = code
        self.body = {"error": message, **details}


@contextmanager
def serving() -> Iterator[Hub]:
    hub = Hub()
    with served(type("Handler", (_Handler,), {"hub": hub})) as hub.url:
        yield hub


class _Handler(BaseHTTPRequestHandler):
    hub: Hub
    protocol_version = "HTTP/1.1"

    def _answer(self) -> None:
        path = unquote(urlsplit(self.path).path)
        self.hub.requests.append(f"{self.command} {path}")
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        try:
            if self.command in ("POST", "DELETE") or path == WHOAMI:
                self._check_token()
            for method, pattern, route in ROUTES:
                if method in (self.command, "ANY") and (found := re.fullmatch(pattern, path)):
                    return self._send(200, *route(self, body, **found.groupdict()))
            raise RefusalError(404, "EntryNotFound", f"no route {self.command} {path}")
        except RefusalError as refusal:
            headers = {"X-Error-Code": refusal.code} if refusal.code else {}
            return self._send(refusal.status, json.dumps(refusal.body).encode(), headers)

    do_GET = do_HEAD = do_POST = do_PUT = do_DELETE = _answer  # noqa: N815

    def _send(self, status: int, body: bytes, headers: dict[str, str]) -> None:
        self.send_response(status)
        for name, value in {"Content-Length": str(len(body)), **headers}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        pass

    def _check_token(self) -> None:
        if self.headers.get("Authorization") != f"Bearer {TOKEN}":
            raise RefusalError(401)

    def repo(self, kind: str, name: str) -> Repo:
        if found := self.hub.repos.get(f"{kind}/{name}"):
            return found
        raise RefusalError(404, "RepoNotFound", "Repository not found")

    def sha(self, repo: Repo, revision: str) -> str:
        known = {"main": repo.head} | repo.tags | {sha: sha for sha in repo.commits}
        if revision in known:
            return known[revision]
        raise RefusalError(404, "RevisionNotFound", "Invalid rev id")


Answer = tuple[bytes, dict[str, str]]


def _json(value: Any) -> Answer:
    return json.dumps(value).encode(), {"Content-Type": "application/json"}


def _oid(name: str, content: bytes) -> str:
    """The sha256 of a large file, git's hash of another one."""
    if _is_large(name):
        return hashlib.sha256(content).hexdigest()
    return hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest()


def _lfs(name: str, content: bytes) -> dict[str, Any] | None:
    return (
        {"sha256": _oid(name, content), "size": len(content), "pointerSize": 134}
        if _is_large(name)
        else None
    )


def _is_large(name: str) -> bool:
    return not name.endswith((*REGULAR, ".gitattributes"))


def whoami(handler: _Handler, body: bytes) -> Answer:
    return _json({"type": "user", "name": "me", "orgs": [], "auth": {"type": "access_token"}})


def create(handler: _Handler, body: bytes) -> Answer:
    asked = json.loads(body)
    owner = asked.get("organization") or "me"
    if owner != "me":
        raise RefusalError(403, message=f"You may not write to {owner}")
    key = f"{asked.get('type') or 'model'}s/{owner}/{asked['name']}"
    url = f"{handler.hub.url}/{key.removeprefix('models/')}"
    if key in handler.hub.repos:
        raise RefusalError(409, message="You already created this repo", url=url)
    handler.hub.repos[key] = Repo(asked.get("visibility") == "private")
    return _json({"url": url, "name": f"{owner}/{asked['name']}"})


def info(
    handler: _Handler, body: bytes, kind: str, name: str, revision: str | None = None
) -> Answer:
    repo = handler.repo(kind, name)
    sha = handler.sha(repo, revision or "main")
    siblings = [
        {"rfilename": path, "lfs": _lfs(path, content)}
        for path, content in repo.commits[sha].items()
    ]
    return _json(
        {
            "id": name,
            "sha": sha,
            "private": repo.private,
            "tags": [],
            "downloads": 0,
            "siblings": siblings,
        }
    )


def preupload(handler: _Handler, body: bytes, kind: str, name: str, revision: str) -> Answer:
    held = handler.repo(kind, name).files
    names = [file["path"] for file in json.loads(body)["files"]]
    modes = [
        {"path": path, "uploadMode": "lfs" if _is_large(path) else "regular"} for path in names
    ]
    oids = [
        {"shouldIgnore": False, "oid": _oid(path, held[path]) if path in held else None}
        for path in names
    ]
    return _json({"files": [mode | oid for mode, oid in zip(modes, oids, strict=True)]})


def batch(handler: _Handler, body: bytes, name: str) -> Answer:
    objects = json.loads(body)["objects"]
    for entry in objects:
        if entry["oid"] not in handler.hub.blobs:
            entry["actions"] = {"upload": {"href": f"{handler.hub.url}/blobs/{entry['oid']}"}}
    return _json({"transfer": "basic", "objects": objects})


def upload(handler: _Handler, body: bytes, oid: str) -> Answer:
    hub = handler.hub
    if hub.uploads_left == 0:
        raise RefusalError(507, message="storage is full")
    if hub.uploads_left is not None:
        hub.uploads_left -= 1
    assert hashlib.sha256(body).hexdigest() == oid
    hub.blobs[oid] = body
    return b"", {}


def commit(handler: _Handler, body: bytes, kind: str, name: str, revision: str) -> Answer:
    repo = handler.repo(kind, name)
    files = dict(repo.files)
    for line in body.splitlines():
        operation = json.loads(line)
        value = operation["value"]
        if operation["key"] == "file":
            files[value["path"]] = base64.b64decode(value["content"])
        elif operation["key"] == "lfsFile":
            files[value["path"]] = handler.hub.blobs[value["oid"]]
        elif operation["key"] == "deletedFile":
            del files[value["path"]]
    sha = hashlib.sha1(
        f"{repo.head}{sorted((n, _oid(n, c)) for n, c in files.items())}".encode()
    ).hexdigest()
    repo.commits[sha] = files
    return _json(
        {"success": True, "commitOid": sha, "commitUrl": f"{handler.hub.url}/{name}/commit/{sha}"}
    )


def refs(handler: _Handler, body: bytes, kind: str, name: str) -> Answer:
    repo = handler.repo(kind, name)
    tags = [
        {"name": tag, "ref": f"refs/tags/{tag}", "targetCommit": sha}
        for tag, sha in repo.tags.items()
    ]
    main = {"name": "main", "ref": "refs/heads/main", "targetCommit": repo.head}
    return _json({"branches": [main], "tags": tags, "converts": []})


def make_tag(handler: _Handler, body: bytes, kind: str, name: str, revision: str) -> Answer:
    repo = handler.repo(kind, name)
    if (tag := json.loads(body)["tag"]) in repo.tags:
        raise RefusalError(409, message="Tag exists")
    repo.tags[tag] = handler.sha(repo, revision)
    return _json({})


def delete_tag(handler: _Handler, body: bytes, kind: str, name: str, revision: str) -> Answer:
    if handler.repo(kind, name).tags.pop(revision, None) is None:
        raise RefusalError(404, "RevisionNotFound", "Tag not found")
    return _json({})


def tree(handler: _Handler, body: bytes, kind: str, name: str, revision: str) -> Answer:
    """List all files, as the client asks when it lists those of a repository."""
    repo = handler.repo(kind, name)
    assert "recursive=true" in handler.path.lower()
    files = repo.commits[handler.sha(repo, revision)]
    return _json(
        [{"type": "file", "path": p, "size": len(c), "oid": _oid(p, c)} for p, c in files.items()]
    )


def resolve(handler: _Handler, body: bytes, **parts: str) -> Answer:
    revision = parts["revision"]
    path = parts["path"]
    repo = handler.repo(parts.get("kind", "models"), parts["name"])
    sha = handler.sha(repo, revision)
    if path not in (files := repo.commits[sha]):
        raise RefusalError(404, "EntryNotFound", "Entry not found")
    content = files[path]
    return content, {
        "ETag": f'"{_oid(path, content)}"',
        "X-Repo-Commit": sha,
        "Accept-Ranges": "none",
    }


def valid(handler: _Handler, body: bytes) -> Answer:
    return _json({"errors": [], "warnings": []})


WHOAMI = "/api/whoami-v2"
API = r"/api/(?P<kind>models|datasets)/(?P<name>[^/]+/[^/]+)"
REVISION = r"/(?P<revision>[^/]+)"
ROUTES = [
    ("GET", WHOAMI, whoami),
    ("POST", "/api/repos/create", create),
    ("POST", "/api/validate-yaml", valid),
    ("GET", API, info),
    ("GET", f"{API}/revision{REVISION}", info),
    ("POST", f"{API}/preupload{REVISION}", preupload),
    ("POST", f"{API}/commit{REVISION}", commit),
    ("GET", f"{API}/refs", refs),
    ("POST", f"{API}/tag{REVISION}", make_tag),
    ("DELETE", f"{API}/tag{REVISION}", delete_tag),
    ("GET", f"{API}/tree{REVISION}", tree),
    ("POST", r"(/datasets)?/(?P<name>[^/]+/[^/]+)\.git/info/lfs/objects/batch", batch),
    ("PUT", r"/blobs/(?P<oid>\w+)", upload),
    ("ANY", rf"/(?P<kind>datasets)/(?P<name>[^/]+/[^/]+)/resolve{REVISION}/(?P<path>.+)", resolve),
    ("ANY", rf"/(?P<name>[^/]+/[^/]+)/resolve{REVISION}/(?P<path>.+)", resolve),
]


if __name__ == "__main__":  # for commands in other processes: prints the address and the token
    with serving() as shared:
        print(shared.url, TOKEN, flush=True)
        threading.Event().wait()
