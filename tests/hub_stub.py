"""A Hub of our own: what the client asks of huggingface.co to store and to fetch a dataset, over HTTP, in memory."""

import base64
import hashlib
import json
import re
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import unquote, urlsplit


class Hub(ThreadingHTTPServer):
    """`commits` by dataset: lists of (commit, content by path), the newest last."""

    def __init__(self):
        super().__init__(("127.0.0.1", 0), _Handler)
        self.commits: dict[str, list[tuple[str, dict[str, bytes]]]] = {}
        self.address = f"http://127.0.0.1:{self.server_port}"
        threading.Thread(target=self.serve_forever, daemon=True).start()

    def add(self, name, files, without=()):
        """A commit with these files changed, and others gone."""
        history = self.commits.setdefault(name, [])
        content = (dict(history[-1][1]) if history else {}) | files
        content = {path: content[path] for path in content if path not in without}
        commit = hashlib.sha1(repr((len(history), sorted(content.items()))).encode()).hexdigest()
        history.append((commit, content))
        return commit

    def at(self, name, revision):
        """(commit, content by path), or None."""
        history = self.commits.get(name, [])
        if revision == "main":
            return history[-1] if history else None
        return next((one for one in history if one[0] == revision), None)


class _Handler(BaseHTTPRequestHandler):
    server: Hub
    protocol_version = "HTTP/1.0"  # no connection outlives the server

    def log_message(self, *_):
        pass

    def _answer(self, status, body=b"", **headers):
        content = body if isinstance(body, bytes) else json.dumps(body).encode()
        self.send_response(status)
        for name, value in ({"Content-Length": len(content)} | headers).items():
            self.send_header(name.replace("_", "-"), str(value))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    def _refuse(self, code):
        self._answer(404, {"error": code}, X_Error_Code=code, X_Error_Message=code)

    def do_POST(self):
        sent = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        path = unquote(urlsplit(self.path).path)
        if path == "/api/repos/create":
            about = json.loads(sent)
            name = f"{about['organization']}/{about['name']}"
            if name not in self.server.commits:
                self.server.add(name, {".gitattributes": b""})
            return self._answer(200, {"url": f"{self.server.address}/datasets/{name}"})
        if path == "/api/validate-yaml":
            return self._answer(200, {"errors": [], "warnings": []})
        name, what = re.fullmatch(r"/api/datasets/([^/]+/[^/]+)/(preupload|commit)/main", path).groups()
        if what == "preupload":
            files = [one["path"] for one in json.loads(sent)["files"]]
            plain = {"uploadMode": "regular", "shouldIgnore": False}
            return self._answer(200, {"files": [{"path": one} | plain for one in files]})
        rows = [json.loads(line) for line in sent.splitlines()]
        files = {r["value"]["path"]: base64.b64decode(r["value"]["content"]) for r in rows if r["key"] == "file"}
        commit = self.server.add(name, files, [r["value"]["path"] for r in rows if r["key"] == "deletedFile"])
        self._answer(200, {"commitUrl": f"{self.server.address}/datasets/{name}/commit/{commit}", "commitOid": commit})

    def do_GET(self):
        path = unquote(urlsplit(self.path).path)
        if asked := re.fullmatch(r"/api/datasets/([^/]+/[^/]+)/(revision|tree)/([^/]+)", path):
            name, what, revision = asked.groups()
            if name not in self.server.commits:
                return self._refuse("RepoNotFound")
            if (found := self.server.at(name, revision)) is None:
                return self._refuse("RevisionNotFound")
            commit, content = found
            if what == "tree":
                rows = [{"type": "file", "path": k, "size": len(v), "oid": _oid(v)} for k, v in content.items()]
                return self._answer(200, rows, Content_Type="application/json")
            about = {"id": name, "sha": commit, "siblings": [{"rfilename": one} for one in content]}
            return self._answer(200, about | {"private": False, "tags": [], "downloads": 0, "likes": 0})
        if asked := re.fullmatch(r"/datasets/([^/]+/[^/]+)/resolve/([^/]+)/(.+)", path):
            name, revision, file = asked.groups()
            commit, content = self.server.at(name, revision)
            return self._answer(200, content[file], ETag=f'"{_oid(content[file])}"', X_Repo_Commit=commit)
        self._refuse(f"nothing at {path}")

    do_HEAD = do_GET


def _oid(content):
    return hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest()
